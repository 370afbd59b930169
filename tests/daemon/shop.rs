//! A machine file, a journal, and the daemon.

use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};
use std::sync::{Arc, Mutex};

use super::client::Client;

const SERVE: &str = "[serve]\nmin_interval_s = 0.0\n\
                     [[serve.cycle]]\nnumber = 1\nmethod = \"self-calibration\"\n\
                     [[serve.cycle]]\nnumber = 2\nmethod = \"latch-delay\"\n\
                     [serve.http]\nlisten = \"127.0.0.1:0\"\n";
const SHORT: &str = "[method.self-calibration]\nmonte_carlo_trials = 100\npositions = 5\n";

pub struct Shop {
    folder: tempfile::TempDir,
}

/// Killed with this value.
pub struct Daemon {
    pub child: Child,
    pub log: Arc<Mutex<String>>,
    pub client: Client,
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Daemon {
    pub fn signal(&self, name: &str) {
        let kill = format!("kill -{name} {}", self.child.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    }

    /// Its exit code.
    pub fn terminate(mut self) -> i32 {
        self.signal("TERM");
        self.child.wait().unwrap().code().unwrap()
    }

    pub fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    pub fn has_said(&self, words: &str) -> bool {
        self.log.lock().unwrap().contains(words)
    }

    /// Of /proc/PID/status, KiB.
    pub fn resident_kib(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
        line.trim().trim_end_matches(" kB").parse().unwrap()
    }
}

/// The built-in machine with few touches, and what may be started; `before`: other keys of [serve].
pub fn served(before: &str) -> String {
    let machine = include_str!("../../config/simulated.toml").split("\n[serve]").next().unwrap();
    format!("{machine}\n{SHORT}{}", SERVE.replacen("[serve]\n", &format!("[serve]\n{before}"), 1))
}

impl Shop {
    pub fn new(machine: &str) -> Self {
        let shop = Self { folder: tempfile::tempdir().unwrap() };
        shop.becomes(machine);
        shop
    }

    pub fn becomes(&self, machine: &str) {
        std::fs::write(self.path("machine.toml"), machine).unwrap();
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn state(&self) -> PathBuf {
        self.path("state")
    }

    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
        command.args(arguments).arg("--state").arg(self.state());
        command
    }

    pub fn trued(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().unwrap()
    }

    /// Until it is ready.
    pub fn serve(&self, speed: &str) -> Daemon {
        let machine = self.path("machine.toml").display().to_string();
        self.serve_as(&["serve", "--machine", &machine, "--speed", speed], |_| {})
    }

    pub fn serve_as(&self, arguments: &[&str], prepare: impl FnOnce(&mut Command)) -> Daemon {
        let mut command = self.command(arguments);
        prepare(&mut command);
        let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
        let mut told = BufReader::new(child.stderr.take().unwrap());
        let (mut line, mut log) = (String::new(), String::new());
        while line.trim() != "ready" {
            line.clear();
            assert_ne!(told.read_line(&mut line).unwrap(), 0, "it does not serve: {log}");
            log += &line;
        }
        let at = log.lines().find_map(|line| line.strip_prefix("the page is at http://127.0.0.1:"));
        let port = at.unwrap().trim_end_matches('/').parse().unwrap();
        let log = Arc::new(Mutex::new(log));
        let more = log.clone();
        std::thread::spawn(move || {
            for line in told.lines().map_while(Result::ok) {
                more.lock().unwrap().push_str(&format!("{line}\n"));
            }
        });
        Daemon { child, log, client: Client { port } }
    }
}
