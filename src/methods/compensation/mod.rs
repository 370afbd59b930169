//! Compensation: computes new values of a control from an estimate and the present values of the control. Reading and
//! writing the control is done elsewhere.
//!
//! A control computes the positions of its rotary axes from its values ([`ControlModel`]). [`MeasuredAxisPositions`]
//! gives the measured positions, [`propose`] the new positions and values. The readings must not contain the effect of
//! the values: they are taken while the control does not apply them. The new position is the measured one.
//!
//! A control adds a table of corrections to the positions of a linear axis ([`ControlledTravel`]). The readings contain
//! the effect of the table: the new correction is the present one minus the measured error.

mod axis_positions;
mod control_model;
mod proposal;
#[cfg(test)]
mod tests;
mod travel;
mod verification;

pub use axis_positions::{MeasuredAxisPositions, RotaryAxisCoordinate};
pub use control_model::{ControlModel, ControlValue, TrunnionPins};
pub use proposal::{Proposal, ProposalOptions, ProposedPosition, ProposedTravel, ProposedValue, propose};
pub use travel::{AxisTravel, ControlledTravel, TravelEntry};
pub use verification::{CorrectedQuantity, RemainingDeviation, compare_remaining_deviations, joint_coverage_ratio};
