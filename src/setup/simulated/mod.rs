//! Joins the simulator with the drivers: what a machine file calls `simulated` becomes an open device.

mod control;
mod sensor;
mod sensor_wire;
#[cfg(test)]
mod tests;

pub use control::{Bench, Faults, Served, SimulatedControl};
pub use sensor::{SimulatedSensor, View};
