//! `trued` keeps five-axis machine tools in tolerance. ARCHITECTURE.md describes the modules.
//!
//! Lengths are in mm, angles in rad, times in s. Other units are used only in files, interfaces and
//! displays; the unit is then part of the name.

#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod archive;
pub mod cli;
pub mod commissioning;
pub mod compensation;
pub mod report;
pub mod run;
pub mod service;
pub mod setup;
pub mod store;
