//! Driver of displacement sensors that send frames on a CAN bus.

mod bus_state;
#[cfg(test)]
mod bus_tests;
mod config;
mod driver;
#[cfg(test)]
mod tests;

pub use config::CanConfig;
