//! Displacement sensors behind Modbus registers, over RTU and TCP: value, status and counter, read at a
//! rate in one request.
//!
//! - Registers show the newest sample alone. With a counter a sample is taken once, and nothing that
//!   was there before `forget`; a counter that stands for the time-out is `Stale`. Without one registers
//!   that stand are told from a surface that rests by the sensor's noise alone, where that is declared
//!   and finer than its counts.
//! - What the sensor measured between two reads was not asked for, and is not missing; with
//!   `counter.gaps = true` it is (`Gap`): for a sensor that is read faster than it measures.
//! - One request reads all. Whether the sensor itself writes a long value in two parts, and was read
//!   between them, cannot be seen from outside: see its manual for which registers it keeps together.
//! - No answer in time, or one that does not fit, is `Stale`. Nothing but these registers is read, and
//!   nothing is written.

mod config;
mod driver;
mod map;
mod standing;
#[cfg(test)]
mod tests;

pub use config::Config;
pub use driver::Registers;
