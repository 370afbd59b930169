//! Errors of commands: what happened, the remedy, and the exit code. Inner layers do not depend on this module.

use std::io::ErrorKind;
use std::path::Path;

use super::ExitStatus;
use crate::archive::run_story::resume_hint;
use crate::run::{CycleError, QualificationError};
use crate::service::{ServeError, TokenError};
use crate::setup::SetupError;
use crate::store::{ArtefactRegisterError, LockError, RunId, StoreError};
use devices::sensors::SensorError;
use methods::{IdentifyError, MethodRefusal};
use planning::PlanningError;
use planning::gcode::RenderError;

/// Error of a command.
#[derive(Debug)]
pub struct CommandFailure {
    pub message: String,
    pub remedy: Option<String>,
    pub exit_status: ExitStatus,
}

impl CommandFailure {
    pub fn new(message: impl ToString, remedy: impl Into<String>) -> Self {
        Self { message: message.to_string(), remedy: Some(remedy.into()), exit_status: ExitStatus::Error }
    }

    pub fn without_remedy(message: impl ToString) -> Self {
        Self { message: message.to_string(), remedy: None, exit_status: ExitStatus::Error }
    }

    /// The error of a file that cannot be read or written.
    pub fn from_file_error(path: &Path, error: &std::io::Error) -> Self {
        Self::without_remedy(format!("{}: {error}", path.display()))
    }

    /// The error of a new file of this `kind` that cannot be written. An existing file is not overwritten.
    pub fn from_new_file_error(path: &Path, error: &std::io::Error, kind: &str) -> Self {
        match error.kind() {
            ErrorKind::AlreadyExists => Self::new(
                format!("the file {} exists already", path.display()),
                format!("a {kind} is never overwritten: choose another name, or move the existing file"),
            ),
            _ => Self::from_file_error(path, error),
        }
    }
}

impl From<SetupError> for CommandFailure {
    fn from(error: SetupError) -> Self {
        Self { message: error.to_string(), remedy: error.remedy(), exit_status: ExitStatus::Error }
    }
}

impl From<SensorError> for CommandFailure {
    fn from(error: SensorError) -> Self {
        Self::new(&error, error.remedy())
    }
}

impl From<ServeError> for CommandFailure {
    fn from(error: ServeError) -> Self {
        Self { message: error.to_string(), remedy: error.remedy(), exit_status: ExitStatus::Error }
    }
}

impl From<TokenError> for CommandFailure {
    fn from(error: TokenError) -> Self {
        Self::new(&error, error.remedy())
    }
}

impl From<ArtefactRegisterError> for CommandFailure {
    fn from(error: ArtefactRegisterError) -> Self {
        Self::new(&error, error.remedy())
    }
}

impl From<StoreError> for CommandFailure {
    fn from(error: StoreError) -> Self {
        Self::new(&error, error.remedy())
    }
}

impl From<LockError> for CommandFailure {
    fn from(error: LockError) -> Self {
        Self::new(&error, error.remedy())
    }
}

impl From<IdentifyError> for CommandFailure {
    fn from(error: IdentifyError) -> Self {
        Self::new(&error, error.remedy())
    }
}

impl From<MethodRefusal> for CommandFailure {
    fn from(refused: MethodRefusal) -> Self {
        Self::new(refused.reason, refused.remedy)
    }
}

impl From<RenderError> for CommandFailure {
    fn from(error: RenderError) -> Self {
        Self::new(&error, error.remedy())
    }
}

impl From<QualificationError> for CommandFailure {
    fn from(error: QualificationError) -> Self {
        Self::new(&error, error.remedy())
    }
}

impl From<PlanningError> for CommandFailure {
    fn from(error: PlanningError) -> Self {
        Self::new(&error, error.remedy())
    }
}

impl CommandFailure {
    /// The error of a cycle of `method`, with the command that continues the run if there is one.
    pub fn from_cycle_error(error: &CycleError, method: &str) -> Self {
        let is_stopped = error.holds_machine() || error.is_requested_stop();
        let exit = if is_stopped { ExitStatus::Stopped } else { ExitStatus::Error };
        match error {
            CycleError::MeasurementIncomplete { run, error, may_have_moved, can_resume, .. } => {
                let prefix = if *may_have_moved { "" } else { "nothing has moved; " };
                let remedy = Some(format!("{prefix}{}", error.remedy()));
                let failure = Self { message: error.to_string(), remedy, exit_status: exit };
                failure.with_resume_hint(*run, *can_resume, error.may_have_lost_position())
            }
            CycleError::NotIdentified { run, why } => {
                Self { message: why.to_string(), remedy: why.remedy(), exit_status: exit }
                    .with_stored_run_hint(*run, method)
            }
            CycleError::Store(error) => Self::new(error, error.remedy()),
            CycleError::Qualification(error) => Self::new(error, error.remedy()),
        }
    }

    /// Adds the command of [`resume_hint`] if the exit status is `Stopped`.
    fn with_resume_hint(mut self, run: RunId, can_resume: bool, position_lost: bool) -> Self {
        if let (ExitStatus::Stopped, Some(remedy)) = (self.exit_status, &mut self.remedy) {
            remedy.push_str(&format!("; {}", resume_hint(run, can_resume, position_lost)));
        }
        self
    }

    /// Adds the commands for a run whose readings are complete.
    fn with_stored_run_hint(self, run: RunId, method: &str) -> Self {
        let next_action = format!(
            "run {run} and its readings are stored: `trued resume {run}` or `trued identify {method} --run \
            {run}` computes the estimate, `trued export {run}` writes the readings to files"
        );
        let remedy = self.remedy.map_or(next_action.clone(), |remedy| format!("{remedy}; {next_action}"));
        Self { remedy: Some(remedy), ..self }
    }
}
