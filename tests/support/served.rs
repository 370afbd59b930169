//! `trued serve` as a child of a trial.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};

/// Killed with this value.
pub struct Served {
    pub child: Child,
    /// What it has said so far.
    pub log: Arc<Mutex<String>>,
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Served {
    /// Until it is ready.
    pub fn start(command: &mut Command) -> Self {
        let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
        let mut told = BufReader::new(child.stderr.take().unwrap());
        let (mut line, mut log) = (String::new(), String::new());
        while line.trim() != "ready" {
            line.clear();
            assert_ne!(told.read_line(&mut line).unwrap(), 0, "it does not serve: {log}");
            log += &line;
        }
        let log = Arc::new(Mutex::new(log));
        let more = log.clone();
        std::thread::spawn(move || {
            for line in told.lines().map_while(Result::ok) {
                more.lock().unwrap().push_str(&format!("{line}\n"));
            }
        });
        Self { child, log }
    }

    /// The port of its page.
    pub fn page(&self) -> u16 {
        self.port("the page is at http://127.0.0.1:")
    }

    /// The port of its registers.
    pub fn modbus(&self) -> u16 {
        self.port("Modbus TCP on 127.0.0.1:")
    }

    fn port(&self, words: &str) -> u16 {
        let log = self.log.lock().unwrap();
        let port = log.lines().find_map(|line| line.strip_prefix(words));
        let port = port.unwrap_or_else(|| panic!("no `{words}` in {log}"));
        port.trim_end_matches('/').parse().unwrap()
    }

    pub fn signal(&self, name: &str) {
        let kill = format!("kill -{name} {}", self.child.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    }

    /// Its exit code.
    pub fn terminate(mut self) -> i32 {
        self.signal("TERM");
        self.child.wait().unwrap().code().unwrap()
    }
}
