//! Driver of displacement sensors behind Modbus registers, over RTU and TCP: value, status and counter are
//! read at a fixed rate, in one request.
//!
//! - The registers hold only the newest sample. With a counter each sample is used once, and none from
//!   before `discard_old_samples`; a counter that does not change within the timeout gives `Stale`. Without a counter,
//!   only the sensor's noise distinguishes registers that are not updated from a surface at rest, if the
//!   noise is declared and greater than the counts.
//! - Samples that the sensor measured between two reads do not count as missing. With `counter.gaps = true`
//!   they do (`Gap`): for a sensor that is read faster than it measures.
//! - One request reads all registers. A read between two partial writes of a long value cannot be
//!   detected: the sensor's manual names the registers that it updates together.
//! - A missing, late or invalid answer gives `Stale`. Only these registers are read, and none is written.

mod config;
mod driver;
mod frozen_value;
mod register_map;
#[cfg(test)]
mod tests;

pub use config::ModbusSensorConfig;
pub use driver::ModbusSensorDriver;
