//! How a run can end before its end.

use crate::controllers::ControllerError;
use crate::gcode::RenderError;
use crate::methods::Refused;
use crate::planning::PlanningError;
use crate::proof::Refusal;
use crate::store::StoreError;

#[derive(Debug, thiserror::Error)]
pub enum RunError {
    #[error(transparent)]
    Refused(#[from] Refused),
    #[error(transparent)]
    Planning(#[from] PlanningError),
    #[error("stage `{stage}` is not proven: {source}")]
    Unproven { stage: String, source: Box<Refusal> },
    #[error("the proof of stage `{stage}` ended without answer")]
    ProofGone { stage: String },
    #[error("stage `{stage}` cannot be written for this control: {source}")]
    Unwritable { stage: String, source: RenderError },
    #[error(transparent)]
    Controller(#[from] ControllerError),
    #[error("step {step} ended without the position of its contact")]
    NoReading { step: u32 },
    #[error("nothing more is measured, because it could not be kept: {0}")]
    Store(#[from] StoreError),
}

impl RunError {
    /// What to do next.
    pub fn remedy(&self) -> String {
        match self {
            Self::Refused(refused) => refused.instead.clone(),
            Self::Planning(error) => error.remedy(),
            Self::Unproven { source, .. } => source.remedy().to_owned(),
            Self::ProofGone { .. } => "please report this with the plan".to_owned(),
            Self::Unwritable { source, .. } => source.remedy(),
            Self::Controller(error) => error.remedy(),
            Self::NoReading { .. } => "please report this with the run's export".to_owned(),
            Self::Store(error) => error.remedy().to_owned(),
        }
    }

    /// A person asked for it.
    pub fn is_stop(&self) -> bool {
        matches!(self, Self::Controller(ControllerError::Halted))
    }
}
