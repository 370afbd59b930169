//! Errors of one cycle, and their messages.

use super::machine_state::RunFailure;
use crate::run::CycleError;
use crate::setup::SetupError;
use crate::store::ArtefactRegisterError;

/// Why a started or resumed cycle ended without an estimate.
#[derive(Debug, thiserror::Error)]
pub(super) enum CycleFailure {
    /// The method cannot be configured, or a device cannot be opened: this cycle has measured nothing.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// The register of artefacts does not permit the run: this cycle has measured nothing.
    #[error(transparent)]
    Artefact(#[from] ArtefactRegisterError),
    /// The run could not begin, its measurement is incomplete, or the measured run is not identified.
    #[error(transparent)]
    Cycle(#[from] CycleError),
}

impl CycleFailure {
    /// Message and remedy.
    pub(super) fn describe(&self) -> RunFailure {
        let (what, remedy) = match self {
            Self::Setup(error) => return RunFailure { what: error.to_string(), remedy: error.remedy() },
            Self::Artefact(error) => (error.to_string(), error.remedy()),
            Self::Cycle(CycleError::MeasurementIncomplete { run, error, .. }) => {
                (format!("run {run}: {error}"), error.remedy())
            }
            Self::Cycle(CycleError::NotIdentified { run, why }) => (
                format!("run {run} is measured and stored, but not identified: {why}"),
                why.remedy().map_or(String::new(), |remedy| format!("{remedy}; "))
                    + &format!("`trued resume {run}` repeats the identification; the machine does not move"),
            ),
            Self::Cycle(CycleError::Store(error)) => (error.to_string(), error.remedy().to_owned()),
            Self::Cycle(CycleError::Qualification(error)) => (error.to_string(), error.remedy()),
        };
        RunFailure { what, remedy: Some(remedy) }
    }
}
