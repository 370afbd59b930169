//! Simulated sensors. They share no code with the drivers; each module publishes its data sheet as keys of a
//! table of the machine file, the only information that a driver gets.

pub mod can;
pub mod modbus;
pub mod serial;
mod serve;

pub use serve::{SampleSource, ServedSensor, listen_locally};

use crate::SensorOutput;

/// Distance, mm, and status bits as transmitted: 1 no echo, 2 out of range, 4 saturated. Without a distance a sensor
/// sends zero.
fn distance_mm_and_status_bits(output: SensorOutput) -> (f64, u8) {
    match output {
        SensorOutput::Distance(mm) => (mm, 0),
        SensorOutput::NoEcho => (0.0, 1),
        SensorOutput::OutOfRange(mm) => (mm, OUT_OF_RANGE_STATUS_MASK),
        SensorOutput::TooMuchLight => (0.0, 4),
    }
}

/// Mask (not index) of the status bit for a distance out of range.
const OUT_OF_RANGE_STATUS_MASK: u8 = 2;
