//! A machine file and a state folder in a temporary folder, and the program that uses them.

use std::path::PathBuf;
use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;

use super::daemon_process::DaemonProcess;

/// `[serve.modbus]` of a machine file.
pub const MODBUS_SECTION: &str = "[serve.modbus]\nlisten = \"127.0.0.1:0\"\nallow = [\"127.0.0.1\"]\n";

/// The built-in machine without `[serve]`, with a fast first approach.
pub fn built_in_machine_text() -> String {
    let file = include_str!("../../config/simulated.toml");
    with_quick_approach(file.split("\n[serve]").next().unwrap())
}

/// The built-in machine's text with a search feed five times as high: in real time the first touch comes after 6 s,
/// not after 25 s.
pub fn with_quick_approach(machine_text: &str) -> String {
    let (slow, fast) = ("search_feed_mm_min = 300.0", "search_feed_mm_min = 1500.0");
    assert!(machine_text.contains(slow));
    machine_text.replace(slow, fast)
}

pub struct MachineShop {
    folder: TempDir,
    /// Environment variables of each program that the shop starts.
    pub environment_variables: Vec<(String, String)>,
}

impl MachineShop {
    pub fn with_machine_file(machine_text: &str) -> Self {
        let shop = Self { folder: tempfile::tempdir().unwrap(), environment_variables: Vec::new() };
        shop.replace_machine_file(machine_text);
        shop
    }

    /// The built-in machine with cycle 1 of `[serve]`; `trigger`: the rest of `[serve]`.
    pub fn with_serve(trigger: &str) -> Self {
        let machine = built_in_machine_text();
        let cycle = "[method.self-calibration]\nmonte_carlo_trials = 1000\n\
                     [tolerance]\nEX0C_um = 500.0\nEY0C_um = 500.0\n\
                     [serve]\nmin_interval_s = 0.0\n\
                     [[serve.cycle]]\nnumber = 1\nmethod = \"self-calibration\"\n";
        Self::with_machine_file(&format!("{machine}\n{cycle}{trigger}"))
    }

    pub fn replace_machine_file(&self, machine_text: &str) {
        std::fs::write(self.machine_path(), machine_text).unwrap();
    }

    /// Replaces text of the machine file.
    pub fn replace_in_machine_file(&self, from: &str, to: &str) {
        let text = std::fs::read_to_string(self.machine_path()).unwrap();
        assert!(text.contains(from), "{from}");
        self.replace_machine_file(&text.replace(from, to));
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn path_text(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }

    /// The machine file.
    pub fn machine_path(&self) -> String {
        self.path_text("machine.toml")
    }

    /// The state folder.
    pub fn state_folder(&self) -> PathBuf {
        self.path("state")
    }

    pub fn trued_command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
        command.args(arguments).arg("--state").arg(self.state_folder());
        command.envs(self.environment_variables.clone());
        command
    }

    pub fn run_trued(&self, arguments: &[&str]) -> Output {
        self.trued_command(arguments).output().unwrap()
    }

    /// `trued run self-calibration --json` on the machine.
    pub fn self_calibration_command(&self) -> Command {
        self.trued_command(&["run", "self-calibration", "--json", "--machine", &self.machine_path()])
    }

    pub fn run_self_calibration(&self) -> Output {
        self.self_calibration_command().output().unwrap()
    }

    /// Step of each exported reading of run 1.
    pub fn exported_reading_steps(&self) -> Vec<u32> {
        let to = self.path_text("export");
        let exported = self.run_trued(&["export", "1", "--to", &to]);
        assert_eq!(exported.status.code(), Some(0), "{}", stderr(&exported));
        let csv = std::fs::read_to_string(self.path("export/run-1-readings.csv")).unwrap();
        let first = |line: &str| line.split(',').next().unwrap().parse().ok();
        csv.lines().filter_map(first).collect()
    }

    /// Standard output, parsed as JSON.
    pub fn run_json(&self, arguments: &[&str]) -> Value {
        let output = self.run_trued(arguments);
        serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{}", stderr(&output)))
    }

    /// State of each run, oldest first.
    pub fn run_states(&self) -> Vec<String> {
        let runs = self.run_json(&["runs", "--json"]);
        let mut runs: Vec<&Value> = runs.as_array().unwrap().iter().collect();
        runs.sort_by_key(|run| run["id"].as_i64());
        runs.iter().map(|run| run["state"].as_str().unwrap().to_owned()).collect()
    }

    /// The daemon with the machine file, ready; `speed`: of the simulated machine.
    pub fn start_daemon(&self, speed: &str) -> DaemonProcess {
        self.start_daemon_with_arguments(&["--speed", speed])
    }

    pub fn start_daemon_with_arguments(&self, arguments: &[&str]) -> DaemonProcess {
        self.start_prepared_daemon(&[&["--machine", &self.machine_path()], arguments].concat(), |_| {})
    }

    pub fn start_prepared_daemon(&self, arguments: &[&str], prepare: impl FnOnce(&mut Command)) -> DaemonProcess {
        let mut command = self.trued_command(&["serve"]);
        command.args(arguments);
        prepare(&mut command);
        DaemonProcess::start(&mut command)
    }
}

pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}
