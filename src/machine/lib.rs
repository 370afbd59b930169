//! A machine tool as data: axes and positions, the nouns of a run (plan, step, reading, estimate),
//! kinematics, artefacts. Does no IO.
//!
//! Lengths are mm, angles rad, times s. Other units stand only at the edges, and there the unit is in
//! the name.

#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod artefact;
pub mod axis;
pub mod frame;
pub mod kinematics;
pub mod record;

pub use axis::{Axis, Position};
