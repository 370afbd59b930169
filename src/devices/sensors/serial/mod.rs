//! Driver of displacement sensors on a serial line, or behind a converter that passes its bytes on: lines
//! of text, or frames of bytes, as the machine file describes them. A sensor sends by itself, or answers
//! requests.
//!
//! The byte stream is cut into whole pieces (`splitter.rs`), and these are decoded by one of two formats
//! (`line.rs`, `frame.rs`):
//! - A piece that cannot be decoded is no sample. If the sensor has a counter, it shows how many samples
//!   are missing; if not, the next valid sample is flagged `Gap`, and the number of missing samples is
//!   unknown. A stream of such pieces alone is silence: `Stale` after the timeout.
//! - An unchanged counter means an old sample: `Stale`.
//! - A line without prefix, suffix, fixed number of columns or counter can lose a digit in transmission and
//!   still be a number. Only a checksum detects this; a checksum of a single byte does so 255 times in 256.
//! - The time of a sample is the time at which the read of its last byte returned.

mod checksum;
mod config;
mod driver;
mod format;
mod frame;
mod line;
mod splitter;
mod startup_diagnosis;
#[cfg(test)]
mod tests;

pub use config::SerialConfig;
pub use driver::SerialDriver;
