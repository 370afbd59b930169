//! Simulated controls: the firmware that moves the simulated machine. They share no code with the drivers.

pub mod grbl;
mod job_executor;
pub mod modbus;
