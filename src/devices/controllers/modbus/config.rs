//! Keys of `[controller]` of kind `modbus`.

use std::path::PathBuf;
use std::sync::Arc;

use serde::Deserialize;

use super::program::{self, ResidentProgram};
use super::{WindowRegisterMap, map};
use link::HostPort;
use link::modbus::{Framing, ModbusDeviceConfig, ModbusDeviceKeys, Parity};

/// Keys of `[controller]` of kind `modbus`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ModbusConfigKeys {
    serial: Option<PathBuf>,
    /// Name of a port in `/dev/serial/by-id`, or a part that occurs in one name only.
    serial_id: Option<String>,
    baud: Option<u32>,
    parity: Option<Parity>,
    tcp: Option<HostPort>,
    framing: Option<Framing>,
    /// Unit identifier of the Modbus device.
    unit: Option<u8>,
    /// Maximum time until the reply to one Modbus request, s.
    timeout_s: Option<f64>,
    /// G-code dialect, a folder of `gcode-templates/`; the default is `grbl-m19`.
    #[serde(default = "default_dialect")]
    dialect: String,
    /// Registers of the window; if absent, those of the published window.
    registers: Option<map::keys::RegisterMapKeys>,
    /// Resident program; if absent, the control executes lines.
    program: Option<program::ProgramKeys>,
}

fn default_dialect() -> String {
    "grbl-m19".to_owned()
}

/// Control behind a window of Modbus registers, which executes lines or has a resident program.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "ModbusConfigKeys")]
pub struct ModbusConfig {
    pub(super) device: ModbusDeviceConfig,
    pub(super) map: WindowRegisterMap,
    /// Resident program behind the window, used instead of lines.
    pub(super) program: Option<Arc<ResidentProgram>>,
    pub(super) dialect: String,
}

impl TryFrom<ModbusConfigKeys> for ModbusConfig {
    type Error = String;

    fn try_from(keys: ModbusConfigKeys) -> Result<Self, String> {
        let ModbusConfigKeys { serial, serial_id, baud, parity, tcp, framing, unit, timeout_s, .. } = keys;
        let device = ModbusDeviceKeys { serial, serial_id, baud, parity, tcp, framing, unit, timeout_s };
        let registers = keys.registers.unwrap_or_default();
        let Some(program) = keys.program else {
            let (device, map) = (device.try_into()?, registers.try_into()?);
            return Ok(Self { device, map, program: None, dialect: keys.dialect });
        };
        let (device, map) = (device.try_into()?, registers.into_program_map()?);
        let program = Some(Arc::new(ResidentProgram::from_keys(program, &map)?));
        Ok(Self { device, map, program, dialect: keys.dialect })
    }
}
