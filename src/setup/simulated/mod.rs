//! Connects the simulator to the drivers: opens the devices that a machine file declares as `simulated`.

mod control;
mod sensor;
mod sensor_wire;
#[cfg(test)]
mod tests;

pub use control::{SimulatedControlConfig, SimulatedControlServer, SimulatedFaults, SimulationSetup};
pub use sensor::SimulatedSensorConfig;
