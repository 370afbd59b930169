//! Simulated sensors. They share no code with the drivers; each module publishes its data sheet as the
//! keys of a machine file's table, which is all that a driver gets to know of it.

pub mod can;
pub mod modbus;
pub mod serial;
mod serve;

pub use serve::{Sense, Served};
