//! Simulated sensors. They share no code with the drivers; each module publishes its data sheet as keys of a
//! table of the machine file, the only information that a driver gets.

pub mod can;
pub mod modbus;
pub mod serial;
mod serve;

pub use serve::{SampleSource, ServedSensor};
