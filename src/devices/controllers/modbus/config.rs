//! Keys of `[controller]` of kind `modbus`.

use std::path::PathBuf;
use std::sync::Arc;

use serde::Deserialize;

use super::program::{self, ResidentProgram};
use super::{RegisterMap, map};
use link::HostPort;
use link::modbus::{Framing, ModbusDevice, ModbusDeviceKeys, Parity};

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ModbusConfigKeys {
    serial: Option<PathBuf>,
    serial_id: Option<String>,
    baud: Option<u32>,
    parity: Option<Parity>,
    tcp: Option<HostPort>,
    framing: Option<Framing>,
    unit: Option<u8>,
    timeout_s: Option<f64>,
    #[serde(default = "default_dialect")]
    dialect: String,
    registers: Option<map::keys::RegisterMapKeys>,
    program: Option<program::ProgramKeys>,
}

fn default_dialect() -> String {
    "grbl-m19".to_owned()
}

#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "ModbusConfigKeys")]
pub struct ModbusConfig {
    pub(super) device: ModbusDevice,
    pub(super) map: RegisterMap,
    /// Resident program behind the window, used instead of lines.
    pub(super) program: Option<Arc<ResidentProgram>>,
    pub(super) dialect: String,
}

type WindowConfig = (RegisterMap, Option<Arc<ResidentProgram>>);

/// Converts the keys to the register map of the window, and to the resident program if there is one.
fn window_config(
    registers: map::keys::RegisterMapKeys,
    program: Option<program::ProgramKeys>,
) -> Result<WindowConfig, String> {
    let Some(keys) = program else { return Ok((registers.try_into()?, None)) };
    let map = registers.into_program_map()?;
    let program = ResidentProgram::from_keys(keys, &map)?;
    Ok((map, Some(Arc::new(program))))
}

impl TryFrom<ModbusConfigKeys> for ModbusConfig {
    type Error = String;

    fn try_from(keys: ModbusConfigKeys) -> Result<Self, String> {
        let ModbusConfigKeys {
            serial,
            serial_id,
            baud,
            parity,
            tcp,
            framing,
            unit,
            timeout_s,
            dialect,
            registers,
            program,
        } = keys;
        let device = ModbusDeviceKeys { serial, serial_id, baud, parity, tcp, framing, unit, timeout_s };
        let device = ModbusDevice::try_from(device)?;
        let (map, program) = window_config(registers.unwrap_or_default(), program)?;
        Ok(Self { device, map, program, dialect })
    }
}
