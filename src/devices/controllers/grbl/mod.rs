//! Driver of grblHAL with five axes, over serial, pty, TCP or in process. Classic Grbl has three axes and
//! is refused if the machine has rotary axes.
//!
//! The driver sends one line at a time and waits for its answer; a move ends only when the control reports
//! idle at the target. A hold (`!`) closes the link for lines; the driver never resets, unlocks or resumes.
//!
//! Grbl's lines carry no checksum. Therefore a surplus answer ends the job, each touch is read a second
//! time (`$#`) and must be on the path of the move, and the modes are read back before anything moves. One
//! risk remains: an altered motion line is detected only *after* its motion. Use a link that checks its
//! data.

mod check;
mod config;
mod connection;
mod connection_diagnosis;
mod device_info;
mod driver;
mod fault;
#[cfg(test)]
mod fuzz;
mod homing;
mod message;
mod prepare;
mod readiness;
mod settings;
#[cfg(test)]
mod tests;
mod timeouts;
mod touch;
mod work_offset;

pub use config::GrblConfig;
pub use driver::GrblDriver;
pub use timeouts::GrblTimeouts;

pub const CONTROL_KIND: &str = "grbl";
