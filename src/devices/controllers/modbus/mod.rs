//! A control, or a PLC before one, that takes lines of text through a window of Modbus registers, and
//! shows its state in another. The window is ours; `docs/line-window.md` publishes it. Over RTU and TCP.
//!
//! - **A chunk counts once.** It is laid down, read back, and acted upon when its sequence is written.
//!   The control takes each sequence but once, and only the one that follows. So what was not answered
//!   may be written again, and a late request cannot move anything a second time.
//! - **The status is one block**, read at once. Head and tail that differ: it was written meanwhile. A
//!   status of another sequence is not used.
//! - **A contact is latched by the control**: its counter has gone up by one, or there was none.
//! - **Both sides have a heartbeat.** The control stops by itself what moves when ours stops; a control
//!   whose heartbeat stands has told us nothing.
//!
//! **Stop.** A halt writes `hold` before everything that waits, and nothing is written after it. It is
//! no emergency stop: it needs the wire and the control's program.

mod config;
mod crc;
mod diagnose;
mod driver;
mod fault;
mod introduce;
mod map;
mod open;
mod otherwise;
mod patience;
mod prepare;
mod program;
mod start;
mod status;
#[cfg(test)]
mod tests;
mod watch;
mod window;

pub use config::Config;
pub use driver::ModbusControl;
use map::Map;
pub use patience::Patience;

pub const KIND: &str = "modbus";
