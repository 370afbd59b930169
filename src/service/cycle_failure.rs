//! Errors of one cycle, and their messages.

use super::machine_state::Failure;
use crate::run::CycleError;
use crate::setup::SetupError;

/// Why a cycle has no estimate.
#[derive(Debug, thiserror::Error)]
pub(super) enum CycleFailure {
    #[error(transparent)]
    Setup(#[from] SetupError),
    #[error(transparent)]
    Cycle(#[from] CycleError),
}

impl CycleFailure {
    /// Whether a requested stop ended the cycle.
    pub(super) fn is_stop(&self) -> bool {
        matches!(self, Self::Cycle(error) if error.is_stop())
    }
}

/// Message and remedy of a cycle that failed.
pub(super) fn describe_failure(error: &CycleError) -> Failure {
    let (what, remedy) = match error {
        CycleError::Run { run, error, .. } => (format!("run {run}: {error}"), error.remedy()),
        CycleError::Identification { run, why } => (
            format!("run {run} is measured and stored, but not identified: {why}"),
            why.remedy().map_or(String::new(), |remedy| format!("{remedy}; "))
                + &format!("`trued resume {run}` repeats the identification; the machine does not move"),
        ),
        CycleError::Store(error) => (error.to_string(), error.remedy().to_owned()),
        CycleError::Qualification(error) => (error.to_string(), error.remedy()),
    };
    Failure { what, remedy: Some(remedy) }
}
