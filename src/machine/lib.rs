//! Data of a machine tool: axes and positions, the records of a run (plan, step, reading, estimate), kinematics,
//! artefacts. No IO.
//!
//! Lengths are in mm, angles in rad, times in s. Other units occur only in input and output data; there the name
//! contains the unit.

#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod artefact;
pub mod axis;
mod error_name;
pub mod frame;
pub mod kinematics;
pub mod record;

pub use axis::{Axis, Position};
pub use error_name::geometric_error_name;
