//! Errors at the edge: what happened, what to do next, and the exit code. Inner layers know none
//! of this.

use std::path::Path;

use super::Exit;
use super::story::goes_on;
use crate::gcode::RenderError;
use crate::methods::{IdentifyError, Refused};
use crate::planning::PlanningError;
use crate::run::RunError;
use crate::setup::SetupError;
use crate::store::{LockError, RunId, StoreError};

#[derive(Debug)]
pub struct Failure {
    pub what: String,
    pub remedy: Option<String>,
    pub exit: Exit,
}

impl Failure {
    pub fn new(what: impl ToString, remedy: impl Into<String>) -> Self {
        Self { what: what.to_string(), remedy: Some(remedy.into()), exit: Exit::Error }
    }

    pub fn plain(what: impl ToString) -> Self {
        Self { what: what.to_string(), remedy: None, exit: Exit::Error }
    }

    /// A file that cannot be read or written.
    pub fn file(path: &Path, error: &std::io::Error) -> Self {
        Self::plain(format!("{}: {error}", path.display()))
    }
}

impl From<SetupError> for Failure {
    fn from(error: SetupError) -> Self {
        Self { what: error.to_string(), remedy: error.remedy(), exit: Exit::Error }
    }
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        Self::new(&error, error.remedy())
    }
}

impl From<LockError> for Failure {
    fn from(error: LockError) -> Self {
        Self::new(&error, error.remedy())
    }
}

impl From<IdentifyError> for Failure {
    fn from(error: IdentifyError) -> Self {
        Self::new(&error, error.remedy())
    }
}

impl From<Refused> for Failure {
    fn from(refused: Refused) -> Self {
        Self::new(refused.why, refused.instead)
    }
}

impl From<RenderError> for Failure {
    fn from(error: RenderError) -> Self {
        Self::new(&error, error.remedy())
    }
}

impl From<PlanningError> for Failure {
    fn from(error: PlanningError) -> Self {
        Self::new(&error, error.remedy())
    }
}

impl Failure {
    /// How a run ended; `moved`: it ended on the way and the machine stands there; `resumed`: it was
    /// interrupted before.
    pub fn of_run(error: &RunError, moved: bool, resumed: bool) -> Self {
        let exit = match error {
            _ if error.closes() => Exit::Error,
            _ if moved || resumed || error.is_stop() => Exit::Stopped,
            _ => Exit::Error,
        };
        let stands = if moved { "" } else { "nothing has moved; " };
        Self { what: error.to_string(), remedy: Some(format!("{stands}{}", error.remedy())), exit }
    }

    /// Of a run in the journal: with the way on, where there is one. `can_resume`: its references were
    /// measured.
    pub fn of_stored(mut self, run: RunId, can_resume: bool) -> Self {
        if let (Exit::Stopped, Some(remedy)) = (self.exit, &mut self.remedy) {
            remedy.push_str(&format!("; {}", goes_on(run, can_resume)));
        }
        self
    }
}
