//! Drivers of machine controls and of sensors. A driver owns its link; it plans nothing and fits nothing.

#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod compensation;
pub mod controllers;
mod finite_numbers;
pub mod sensors;
