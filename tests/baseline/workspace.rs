//! The program in a separate folder: machine file, journal, outputs.

use std::fs;
use std::process::{Command, Output};

use serde_json::Value;

pub struct Workspace {
    folder: tempfile::TempDir,
}

impl Workspace {
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    /// A workspace with this `machine.toml`.
    pub fn with_machine(text: &str) -> Self {
        let workspace = Self::new();
        fs::write(workspace.path("machine.toml"), text).unwrap();
        workspace
    }

    pub fn path(&self, name: &str) -> String {
        self.folder.path().join(name).display().to_string()
    }

    pub fn read(&self, name: &str) -> String {
        let path = self.path(name);
        fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
    }

    /// `trued` with its journal in this workspace.
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
        command.args(arguments).args(["--state", &self.path("state")]);
        command
    }

    pub fn output(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().unwrap()
    }

    /// Standard output of a command that succeeds.
    pub fn stdout(&self, arguments: &[&str]) -> String {
        let output = self.output(arguments);
        assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
        String::from_utf8(output.stdout).unwrap()
    }

    pub fn json(&self, arguments: &[&str]) -> Value {
        serde_json::from_str(&self.stdout(arguments)).unwrap()
    }
}

pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Each `from` is the beginning of a line that occurs once or more; the first one is replaced.
pub fn with_replaced_lines(file: &str, changes: &[(&str, &str)]) -> String {
    let mut text = file.to_owned();
    for (from, to) in changes {
        let from = format!("\n{from}");
        assert!(text.contains(&from), "no line begins with {from:?}");
        text = text.replacen(&from, &format!("\n{to}"), 1);
    }
    text
}
