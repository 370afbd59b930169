//! Compensation: from an estimate, and from the values that a control holds now, to the values that it should hold.
//! Pure: reading and writing the control is done elsewhere.
//!
//! A control takes its rotary axes to be at positions, which it computes from its values ([`ControlModel`]).
//! [`MeasuredAxisPositions`] gives the measured positions, [`propose`] the new ones and their values. The readings must
//! not contain the effect of these values: they are measured while the control does not apply them. The new position is
//! the measured one.
//!
//! A control adds a table of corrections to the positions of a linear axis ([`ControlledTravel`]). The readings contain
//! its effect: the new correction is the present one and the negative of the measured error.

mod axis_positions;
mod control_model;
mod proposal;
#[cfg(test)]
mod tests;
mod travel;

pub use axis_positions::{AxisCoordinate, MeasuredAxisPositions};
pub use control_model::{ControlModel, ControlValue, TrunnionPins};
pub use proposal::{Proposal, ProposalOptions, ProposedPosition, ProposedTravel, ProposedValue, propose};
pub use travel::{AxisTravel, ControlledTravel, TravelEntry};
