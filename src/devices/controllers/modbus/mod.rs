//! Driver of a control, or of a PLC in front of it, that receives lines of text through a window of Modbus
//! registers, and reports its state in a second window. This project defines the window; `docs/line-window.md`
//! publishes it. Over RTU and TCP.
//!
//! - **A chunk is executed once.** The driver writes it, reads it back, and starts it by writing its
//!   sequence number. The control accepts each number only once, and only the next one. So an unanswered
//!   write may be repeated, and a late request cannot move anything a second time.
//! - **The status is one block**, read in one request. If head and tail differ, it was written during the
//!   read. A status with another sequence number is not used.
//! - **The control latches a contact**: its counter has increased by one, or there was no contact.
//! - **Both sides have a heartbeat.** The control itself stops all motion when the heartbeat of `trued`
//!   stops; the status of a control whose heartbeat has stopped is not valid.
//!
//! **Stop.** A halt writes `hold` before all pending requests, and nothing is written after it. It is not an emergency
//! stop: it depends on the link and on the control's program.

mod chunk_write;
mod config;
mod connection_diagnosis;
mod controller_config;
mod device_info;
mod driver;
mod fault;
mod format_diagnosis;
mod map;
mod prepare;
mod program;
mod status;
#[cfg(test)]
mod tests;
mod timeouts;
mod window;

pub use config::ModbusConfig;
pub use driver::ModbusDriver;
use map::WindowRegisterMap;
pub use timeouts::ModbusTimeouts;

/// Value of `kind` in `[controller]`.
pub const CONTROL_KIND: &str = "modbus";
