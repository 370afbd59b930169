//! Compensation of measured errors in the control: proposal from a stored run, write with read-back, and undo.

mod proposal;
mod target;
mod values_record;
mod write;

pub use proposal::{ControlProposal, ControlProposalError, propose_for_control};
pub use target::{CompensationTarget, TargetError};
pub use values_record::describe_values_of_control;
pub use write::{CompensationWriteError, CompensationWriter};
