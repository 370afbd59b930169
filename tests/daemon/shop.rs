//! A machine file, a journal, and the daemon.

use std::ops::Deref;
use std::path::PathBuf;
use std::process::{Command, Output};

use super::client::Client;
use super::served::Served;

const SERVE: &str = "[serve]\nmin_interval_s = 0.0\n\
                     [[serve.cycle]]\nnumber = 1\nmethod = \"self-calibration\"\n\
                     [[serve.cycle]]\nnumber = 2\nmethod = \"latch-delay\"\n\
                     [serve.http]\nlisten = \"127.0.0.1:0\"\n";
const SHORT: &str = "[method.self-calibration]\nmonte_carlo_trials = 100\npositions = 5\n";

pub struct Shop {
    folder: tempfile::TempDir,
}

pub struct Daemon {
    pub served: Served,
    pub client: Client,
}

impl Deref for Daemon {
    type Target = Served;

    fn deref(&self) -> &Served {
        &self.served
    }
}

impl Daemon {
    /// Its exit code.
    pub fn terminate(self) -> i32 {
        self.served.terminate()
    }

    pub fn kill(&mut self) {
        self.served.child.kill().unwrap();
        self.served.child.wait().unwrap();
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
        let served = Served::start(&mut command);
        let client = Client { port: served.page() };
        Daemon { served, client }
    }
}
