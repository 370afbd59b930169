//! `trued` keeps five-axis machine tools in tolerance. Start with ARCHITECTURE.md, which says what is where.
//!
//! Lengths are mm, angles rad, times s. Other units stand only at the edges, and
//! there the unit is in the name.

#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod archive;
pub mod cli;
pub mod commissioning;
pub mod report;
pub mod run;
pub mod service;
pub mod setup;
pub mod store;
