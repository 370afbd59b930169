//! The ways in: the daemon's own Modbus TCP server, and a line of text. Both ask at the desk.

pub mod line;
pub mod modbus;

use super::config::Config;
use super::desk::Desk;
use super::{Log, ServeError};

/// Start what the configuration names. Call inside a tokio runtime.
///
/// # Errors
/// An address that cannot be listened on; a thread that cannot be started.
pub fn start(config: &Config, desk: &Desk, log: &Log) -> Result<(), ServeError> {
    if let Some(modbus) = &config.modbus {
        modbus::start(modbus, desk, log)?;
    }
    if let Some(line) = &config.line {
        tokio::spawn(line::attend(line.0.clone(), desk.clone(), log.clone()));
    }
    Ok(())
}
