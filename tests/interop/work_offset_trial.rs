//! `trued compensate` for the work offset of a control, by a stored run of which C is at (50, −30) µm.

use std::process::{Command, Output};

use libtest_mimic::Failed;

use crate::linuxcnc::run_workspace::{RunWorkspace, failure_text};
use crate::support::stored_run::store_run_at;
use trued::setup::MachineFile;
use trued::store::{CompensationState, Journal};

pub struct WorkOffsetTrial<'a>(&'a RunWorkspace);

impl<'a> WorkOffsetTrial<'a> {
    /// `at_mm`: point on the stated axis C at which the run measured its position.
    pub fn new(workspace: &'a RunWorkspace, at_mm: [f64; 3]) -> Result<Self, Failed> {
        let file = MachineFile::read(&workspace.machine_file_path())?;
        let errors = [("EX0C", "um", 50.0), ("EY0C", "um", -30.0)];
        store_run_at(workspace.state_folder(), &file, "self-calibration", at_mm, &errors);
        Ok(Self(workspace))
    }

    pub fn propose(&self) -> Result<Output, Failed> {
        self.0.compensate(&["propose", "1"])
    }

    /// Hash and text of the proposal.
    pub fn proposal(&self) -> Result<(String, String), Failed> {
        let text = stdout(self.propose()?)?;
        eprintln!("{text}");
        let hash = text.lines().find_map(|line| line.strip_prefix("SHA-256 of the proposal: ")).ok_or("no hash")?;
        Ok((hash.to_owned(), text))
    }

    pub fn write(&self, hash: &str) -> Result<Output, Failed> {
        Ok(self.write_command(hash).output()?)
    }

    pub fn write_command(&self, hash: &str) -> Command {
        self.0.compensate_command(&["write", "1", "--approve", hash, "--who", "Ada"])
    }

    pub fn write_stdout(&self, hash: &str) -> Result<String, Failed> {
        stdout(self.write(hash)?)
    }

    pub fn undo(&self) -> Result<Output, Failed> {
        self.0.compensate(&["undo", "--who", "Ada"])
    }

    pub fn undo_stdout(&self) -> Result<String, Failed> {
        stdout(self.undo()?)
    }

    pub fn finish_stdout(&self) -> Result<String, Failed> {
        stdout(self.0.compensate(&["finish", "--who", "Ada"])?)
    }

    /// State of the last compensation in the journal.
    pub fn state(&self) -> Result<Option<CompensationState>, Failed> {
        let machine = MachineFile::read(&self.0.machine_file_path())?.machine.name;
        let compensations = Journal::open(self.0.state_folder())?.compensations(&machine)?;
        Ok(compensations.first().map(|newest| newest.state))
    }
}

fn stdout(output: Output) -> Result<String, Failed> {
    match output.status.success() {
        true => Ok(String::from_utf8_lossy(&output.stdout).into_owned()),
        false => Err(failure_text(&output).into()),
    }
}

/// Checks that the command has failed with this text.
pub fn refusal(output: &Output, expected: &str) -> Result<(), Failed> {
    let text = failure_text(output);
    match !output.status.success() && text.contains(expected) {
        true => Ok(()),
        false => Err(format!("`{expected}` is not in {text}").into()),
    }
}
