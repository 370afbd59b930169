//! Errors of commands: what happened, the remedy, and the exit code. Inner layers do not depend on this module.

use std::path::Path;

use super::Exit;
use crate::archive::story::resume_hint;
use crate::run::{CycleError, Unqualified};
use crate::service::{ServeError, TokenError};
use crate::setup::SetupError;
use crate::store::{LockError, RunId, StoreError};
use devices::sensors::SensorError;
use methods::{IdentifyError, Refused};
use planning::PlanningError;
use planning::gcode::RenderError;

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

    /// The error of a file that cannot be read or written.
    pub fn file(path: &Path, error: &std::io::Error) -> Self {
        Self::plain(format!("{}: {error}", path.display()))
    }
}

impl From<SetupError> for Failure {
    fn from(error: SetupError) -> Self {
        Self { what: error.to_string(), remedy: error.remedy(), exit: Exit::Error }
    }
}

impl From<SensorError> for Failure {
    fn from(error: SensorError) -> Self {
        Self::new(&error, error.remedy())
    }
}

impl From<ServeError> for Failure {
    fn from(error: ServeError) -> Self {
        Self { what: error.to_string(), remedy: error.remedy(), exit: Exit::Error }
    }
}

impl From<TokenError> for Failure {
    fn from(error: TokenError) -> Self {
        Self::new(&error, error.remedy())
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

impl From<Unqualified> for Failure {
    fn from(error: Unqualified) -> Self {
        Self::new(&error, error.remedy())
    }
}

impl From<PlanningError> for Failure {
    fn from(error: PlanningError) -> Self {
        Self::new(&error, error.remedy())
    }
}

impl Failure {
    /// The error of a cycle of `method`, with the command that continues the run if there is one.
    pub fn of_cycle(error: &CycleError, method: &str) -> Self {
        let is_stopped = error.holds() || error.is_stop();
        let exit = if is_stopped { Exit::Stopped } else { Exit::Error };
        match error {
            CycleError::Run { run, error, moved, can_resume, .. } => {
                let stands = if *moved { "" } else { "nothing has moved; " };
                let remedy = Some(format!("{stands}{}", error.remedy()));
                let failure = Self { what: error.to_string(), remedy, exit };
                failure.with_way_on(*run, *can_resume, error.position_lost())
            }
            CycleError::Identification { run, why } => {
                Self { what: why.to_string(), remedy: why.remedy(), exit }.kept(*run, method)
            }
            CycleError::Store(error) => Self::new(error, error.remedy()),
            CycleError::Unqualified(error) => Self::new(error, error.remedy()),
        }
    }

    /// Adds the command of [`resume_hint`].
    fn with_way_on(mut self, run: RunId, can_resume: bool, position_lost: bool) -> Self {
        if let (Exit::Stopped, Some(remedy)) = (self.exit, &mut self.remedy) {
            remedy.push_str(&format!("; {}", resume_hint(run, can_resume, position_lost)));
        }
        self
    }

    /// Adds the commands for a run whose readings are complete.
    fn kept(self, run: RunId, method: &str) -> Self {
        let way_on = format!(
            "run {run} and its readings are kept: `trued resume {run}` or `trued identify {method} --run \
             {run}` identifies it, `trued export {run}` writes it to files"
        );
        let remedy = self.remedy.map_or(way_on.clone(), |remedy| format!("{remedy}; {way_on}"));
        Self { remedy: Some(remedy), ..self }
    }
}
