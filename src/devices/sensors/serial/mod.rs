//! Displacement sensors on a serial line, or behind a converter that passes its bytes on: lines of text,
//! or frames of bytes, as the machine file describes them. They send by themselves, or answer a request.
//!
//! What comes is cut into whole pieces (`cut.rs`) and understood by one of two forms (`line.rs`,
//! `frame.rs`):
//! - A piece that cannot be understood is no sample. Where the sensor counts, its counter says what is
//!   missing; where it does not, the next good sample is flagged `Gap`, and how much is missing is not
//!   known. Nothing but such pieces is silence: `Stale` after the time-out.
//! - The counter stands: the sample came before, `Stale`.
//! - A line without prefix, suffix, fixed number of columns or counter can lose a digit on its way and
//!   still be a number. Nothing tells that; a checksum does, one of a single byte 255 times in 256.
//! - The time of a sample is that at which the read that completed it returned.

mod checksum;
mod config;
mod cut;
mod driver;
mod form;
mod frame;
mod line;
mod suspect;
#[cfg(test)]
mod tests;

pub use config::Config;
pub use driver::Serial;
