//! Triggers: the daemon's own Modbus TCP server, and a text line. Both send commands to the gate.

pub mod modbus;
pub mod text_line;

use super::command_gate::CommandGate;
use super::config::ServeConfig;
use super::{Log, ServeError};

/// Starts the configured triggers. Call it inside a tokio runtime.
///
/// # Errors
/// An address cannot be listened on, or a thread cannot be started.
pub fn start_triggers(config: &ServeConfig, gate: &CommandGate, log: &Log) -> Result<(), ServeError> {
    if let Some(modbus) = &config.modbus_server_config {
        modbus::start_modbus_server(modbus, gate, log)?;
    }
    if let Some(line) = &config.line_interface_config {
        tokio::spawn(text_line::serve_trigger_line(line.0.clone(), gate.clone(), log.clone()));
    }
    Ok(())
}
