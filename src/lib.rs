//! `trued` keeps five-axis machine tools true. Start with ARCHITECTURE.md; the folders are the floors.
//!
//! Inside the crate lengths are mm, angles rad, times s. Other units stand only at the edges, and
//! there the unit is in the name.

#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod base;
pub mod controllers;
pub mod link;
pub mod methods;
pub mod record;
pub mod setup;
