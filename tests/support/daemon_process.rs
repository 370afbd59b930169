//! `trued serve` as a child process.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::sleep;
use std::time::{Duration, Instant};

use super::http::HttpClient;

const LOG_TIMEOUT: Duration = Duration::from_secs(300);

/// The daemon; killed when dropped.
pub struct DaemonProcess {
    pub child: Child,
    /// Standard error of the daemon so far.
    pub log: Arc<Mutex<String>>,
}

/// Variables that the systemd unit of the daemon sets; at least one, on which the memory limits of the tests depend.
fn unit_environment() -> Vec<(&'static str, &'static str)> {
    let unit = include_str!("../../systemd/trued.service");
    let variable = |line: &'static str| line.strip_prefix("Environment=")?.split_once('=');
    let variables: Vec<_> = unit.lines().filter_map(variable).collect();
    assert!(variables.iter().any(|(name, _)| *name == "MALLOC_ARENA_MAX"), "{variables:?}");
    variables
}

impl Drop for DaemonProcess {
    fn drop(&mut self) {
        self.kill();
    }
}

impl DaemonProcess {
    /// Starts the daemon in the environment of its systemd unit; blocks until it is ready.
    pub fn start(command: &mut Command) -> Self {
        let mut child = command.envs(unit_environment()).stderr(Stdio::piped()).spawn().unwrap();
        let mut stderr = BufReader::new(child.stderr.take().unwrap());
        let (mut line, mut log) = (String::new(), String::new());
        while line.trim() != "ready" {
            line.clear();
            assert_ne!(stderr.read_line(&mut line).unwrap(), 0, "the daemon ended: {log}");
            log += &line;
        }
        let log = Arc::new(Mutex::new(log));
        let more = log.clone();
        std::thread::spawn(move || {
            for line in stderr.lines().map_while(Result::ok) {
                more.lock().unwrap().push_str(&format!("{line}\n"));
            }
        });
        Self { child, log }
    }

    pub fn http(&self) -> HttpClient {
        HttpClient::new(self.http_port())
    }

    pub fn http_port(&self) -> u16 {
        self.listening_port("the page is at http://127.0.0.1:")
    }

    pub fn modbus_port(&self) -> u16 {
        self.listening_port("Modbus TCP on 127.0.0.1:")
    }

    fn listening_port(&self, prefix: &str) -> u16 {
        let log = self.log();
        let port = log.lines().find_map(|line| line.strip_prefix(prefix));
        let port = port.unwrap_or_else(|| panic!("no `{prefix}` in {log}"));
        port.trim_end_matches('/').parse().unwrap()
    }

    pub fn log(&self) -> String {
        self.log.lock().unwrap().clone()
    }

    pub fn wait_for_log(&self, text: &str) {
        let started = Instant::now();
        while !self.log().contains(text) {
            assert!(started.elapsed() < LOG_TIMEOUT, "no `{text}` in {}", self.log());
            sleep(Duration::from_millis(20));
        }
    }

    pub fn send_signal(&self, name: &str) {
        let kill = format!("kill -{name} {}", self.child.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    }

    pub fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Sends SIGTERM; returns the exit code.
    pub fn terminate(mut self) -> i32 {
        self.send_signal("TERM");
        self.child.wait().unwrap().code().unwrap()
    }

    /// `VmRSS` or `VmHWM` of the daemon, KiB.
    pub fn memory_kib(&self, key: &str) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix(key)).unwrap();
        line.trim_start_matches(':').trim().trim_end_matches(" kB").parse().unwrap()
    }
}
