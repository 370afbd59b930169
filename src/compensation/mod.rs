//! Compensation of measured errors in the control: proposal from a stored run, write with read-back,
//! verification by a second run, and undo.

mod machine_compensation;
mod measured_run;
mod proposal;
mod proposal_table;
mod sheet;
mod target;
mod targets;
mod tool_centre_comparison;
mod values_record;
mod verification;
mod verification_table;
mod write;

pub use machine_compensation::{
    CompensationError, CompensationStatus, HashedProposal, MachineCompensation, ProposalSource,
};
pub use proposal::{ControlProposal, propose_for_control};
pub use proposal_table::{PositionRow, ProposalTable, ValueRow};
pub use sheet::{RenderedSheet, render_correction_sheet};
pub use target::CompensationTarget;
pub use targets::{needs_control_link, open_target};
pub use values_record::{describe_compensation_values, recorded_compensation_file_values};
pub use verification::Verification;
pub use verification_table::{VerificationRow, VerificationTable};
pub use write::{CompensationWriteError, CompensationWriter};
