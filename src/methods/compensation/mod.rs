//! Compensation: from an estimate and from the values that a control holds now to the values that it should hold.
//! Pure: reading and writing the control is done elsewhere.
//!
//! A target is described by its [`TargetValue`]s: each is a sum of positions of rotary axes relative to the spindle.
//! [`propose`] computes new values; [`RotaryAxisModel`] states what the control takes as the position of its axes, so
//! that the error of the tool can be predicted before and after the write.

mod axis_positions;
mod control_model;
mod proposal;
mod target_value;
#[cfg(test)]
mod tests;

pub use axis_positions::{AxisCoordinate, MeasuredAxisPositions, ValueWithUncertainty};
pub use control_model::location_errors_of_control;
pub use proposal::{Proposal, ProposalOptions, ProposedValue, propose};
pub use target_value::{TargetValue, ValueEffect, trunnion_values};
