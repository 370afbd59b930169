//! `trued` keeps five-axis machine tools true. Start with ARCHITECTURE.md; the folders are the floors.
//!
//! Inside the crate lengths are mm, angles rad, times s. Other units stand only at the edges, and
//! there the unit is in the name.

#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod archive;
pub mod artefact;
pub mod base;
pub mod cli;
pub mod commissioning;
pub mod controllers;
pub mod decision;
pub mod estimation;
pub mod gcode;
pub mod kinematics;
pub mod link;
pub mod methods;
pub mod planning;
pub mod proof;
pub mod record;
pub mod report;
pub mod run;
pub mod sensors;
pub mod service;
pub mod setup;
pub mod store;
pub mod world;
