//! Displacement sensors on a CAN bus.

mod config;

pub use config::Config;
