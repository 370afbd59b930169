//! grblHAL with five axes, over serial, pty, TCP or in process. Classic Grbl has three axes and is
//! refused where the machine has rotary ones.
//!
//! One line at a time: sent, answered, and every move ends only when the control reports idle at its
//! target. A hold (`!`) closes the link for lines; nothing here resets, unlocks or resumes.
//!
//! Grbl's wire has no check sum. So an answer too many ends the job, a touch is asked for twice
//! (`$#`) and must lie on the way, and the modes are read back before anything moves. What remains:
//! an altered motion line is noticed *after* its motion. Use a wire that checks what it carries.

mod built;
mod check;
mod config;
mod diagnose;
mod driver;
mod fault;
#[cfg(test)]
mod fuzz;
mod homing;
mod introduce;
mod message;
mod prepare;
mod readiness;
mod settings;
#[cfg(test)]
mod tests;
mod touch;
mod watch;
mod wire;

pub use config::Config;
pub use driver::Grbl;
pub use watch::Patience;

pub const KIND: &str = "grbl";
