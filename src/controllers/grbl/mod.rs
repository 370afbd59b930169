//! grblHAL with five axes, over serial, pty, TCP or in process. Classic Grbl has three axes and is
//! refused where the machine has rotary ones.
//!
//! One line at a time: sent, answered, and a block ends only when the control reports idle. A hold
//! (`!`) closes the link for lines; nothing here resets, unlocks or resumes.

mod driver;
pub mod firmware;
mod message;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod wire;

pub use driver::Grbl;
pub use wire::Patience;
