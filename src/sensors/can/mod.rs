//! Displacement sensors that send frames on a CAN bus.

mod config;
mod driver;
pub mod simulated;
#[cfg(test)]
mod tests;

pub use config::Config;
