//! The program as a person has it: one command, its output, its journal.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

mod bench;
mod captures;
mod faults;
mod firmware;
mod probe;
mod proven;
mod results;
mod resume;
mod samba;
mod stamps;
mod stops;
mod wires;

/// The built-in machine, with few Monte Carlo trials.
fn machine() -> String {
    let file = include_str!("../../config/simulated.toml");
    format!("{file}\n[method.self-calibration]\nmonte_carlo_trials = 1000\n")
}

/// A simulated machine's file, with another control.
fn with_control(file: &str, control: &str) -> String {
    changed(file, &[("kind = \"simulated\"", control), ("wire = \"memory\"", "")])
}

/// Each `from` occurs as the beginning of a line.
fn changed(file: &str, changes: &[(&str, &str)]) -> String {
    let mut text = file.to_owned();
    for (from, to) in changes {
        assert!(text.contains(&format!("\n{from}")), "{from}");
        text = text.replacen(&format!("\n{from}"), &format!("\n{to}"), 1);
    }
    text
}

/// A folder with a machine file and the journal.
struct Shop {
    folder: tempfile::TempDir,
}

impl Shop {
    fn new(machine: &str) -> Self {
        let shop = Self { folder: tempfile::tempdir().unwrap() };
        std::fs::write(shop.file("machine.toml"), machine).unwrap();
        shop
    }

    fn file(&self, name: &str) -> String {
        self.folder.path().join(name).display().to_string()
    }

    /// `trued` with its journal here.
    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
        command.args(arguments).args(["--state", &self.file("state")]);
        command
    }

    fn trued(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().unwrap()
    }

    /// `trued run self-calibration --json` on the machine of this shop.
    fn run_command(&self) -> Command {
        let machine = self.file("machine.toml");
        self.command(&["run", "self-calibration", "--json", "--machine", &machine])
    }

    fn run(&self) -> Output {
        self.run_command().output().unwrap()
    }

    /// State of each run, in the order of their numbers.
    fn states(&self) -> Vec<String> {
        let said = self.trued(&["runs", "--json"]);
        let runs: Vec<Value> = serde_json::from_slice(&said.stdout).unwrap();
        let mut runs: Vec<(i64, String)> = runs
            .iter()
            .map(|run| (run["id"].as_i64().unwrap(), run["state"].as_str().unwrap().to_owned()))
            .collect();
        runs.sort();
        runs.into_iter().map(|(_, state)| state).collect()
    }

    /// Export run 1; the steps of its readings.
    fn exported_steps(&self) -> Vec<u32> {
        let to = self.file("export");
        let exported = self.trued(&["export", "1", "--to", &to]);
        assert_eq!(exported.status.code(), Some(0), "{}", said(&exported));
        let csv = std::fs::read_to_string(Path::new(&to).join("run-1-readings.csv")).unwrap();
        let first = |line: &str| line.split(',').next().unwrap().parse().ok();
        csv.lines().filter_map(first).collect()
    }
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Each of the words is told.
fn tells(output: &Output, words: &[&str]) {
    for word in words {
        assert!(said(output).contains(word), "{word} in {}", said(output));
    }
}

/// The estimate of a run that ended well.
fn estimate(output: &Output) -> Value {
    assert_eq!(output.status.code(), Some(0), "{}", said(output));
    serde_json::from_slice(&output.stdout).unwrap()
}
