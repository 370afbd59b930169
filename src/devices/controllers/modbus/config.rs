//! Keys of `[controller]` of kind `modbus`.

use std::path::PathBuf;
use std::sync::Arc;

use serde::Deserialize;

use super::program::{self, Program};
use super::{Map, map};
use link::HostPort;
use link::modbus::{Device, DeviceKeys, Framing, Parity};

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    serial: Option<PathBuf>,
    serial_id: Option<String>,
    baud: Option<u32>,
    parity: Option<Parity>,
    tcp: Option<HostPort>,
    framing: Option<Framing>,
    unit: Option<u8>,
    #[serde(default = "timeout_s")]
    timeout_s: f64,
    #[serde(default = "dialect")]
    dialect: String,
    registers: Option<map::keys::Keys>,
    program: Option<program::Keys>,
}

fn timeout_s() -> f64 {
    0.5
}

fn dialect() -> String {
    "grbl-m19".to_owned()
}

#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "Keys")]
pub struct Config {
    pub(super) device: Device,
    pub(super) map: Map,
    /// Resident program behind the window, used instead of lines.
    pub(super) program: Option<Arc<Program>>,
    pub(super) dialect: String,
}

type WindowConfig = (Map, Option<Arc<Program>>);

/// Converts the keys to the register map of the window, and to the resident program if there is one.
fn window(
    registers: map::keys::Keys,
    program: Option<program::Keys>,
) -> Result<WindowConfig, String> {
    let Some(keys) = program else { return Ok((registers.try_into()?, None)) };
    let map = registers.of_program()?;
    let program = Program::of(keys, &map)?;
    Ok((map, Some(Arc::new(program))))
}

impl TryFrom<Keys> for Config {
    type Error = String;

    fn try_from(keys: Keys) -> Result<Self, String> {
        let Keys {
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
        let device = DeviceKeys { serial, serial_id, baud, parity, tcp, framing, unit, timeout_s };
        let device = Device::try_from(device)?;
        let (map, program) = window(registers.unwrap_or_default(), program)?;
        Ok(Self { device, map, program, dialect })
    }
}
