//! Runs the program in a separate folder with its machine file, journal and outputs.

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
    pub fn with_machine_file(machine_text: &str) -> Self {
        let workspace = Self::new();
        fs::write(workspace.file_path("machine.toml"), machine_text).unwrap();
        workspace
    }

    pub fn file_path(&self, name: &str) -> String {
        self.folder.path().join(name).display().to_string()
    }

    pub fn read_file(&self, name: &str) -> String {
        let path = self.file_path(name);
        fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
    }

    /// `trued` with its journal in this workspace.
    pub fn trued_command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
        command.args(arguments).args(["--state", &self.file_path("state")]);
        command
    }

    pub fn run_trued(&self, arguments: &[&str]) -> Output {
        self.trued_command(arguments).output().unwrap()
    }

    /// Standard output of a command that succeeds.
    pub fn run_stdout(&self, arguments: &[&str]) -> String {
        let output = self.run_trued(arguments);
        assert!(output.status.success(), "{arguments:?}: {}", stderr_text(&output));
        String::from_utf8(output.stdout).unwrap()
    }

    pub fn run_json(&self, arguments: &[&str]) -> Value {
        serde_json::from_str(&self.run_stdout(arguments)).unwrap()
    }
}

pub fn stderr_text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Each `from` is the beginning of at least one line; its first occurrence is replaced by `to`.
pub fn replace_line_starts(file: &str, changes: &[(&str, &str)]) -> String {
    let mut text = file.to_owned();
    for (from, to) in changes {
        let from = format!("\n{from}");
        assert!(text.contains(&from), "no line begins with {from:?}");
        text = text.replacen(&from, &format!("\n{to}"), 1);
    }
    text
}
