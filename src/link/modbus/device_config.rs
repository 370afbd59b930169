//! Address and settings of a Modbus device, as written in a file.

use std::path::PathBuf;
use std::time::Duration;

use super::framing::Framing;
use super::line_config::{ModbusLineConfig, Parity};
use super::{AccessList, DeviceSettings};
use crate::{HostPort, LinkConfig, LinkKeys};

/// Default baud rate of the Modbus serial line specification; the default parity is in [`ModbusLineConfig`].
const DEFAULT_BAUD: u32 = 19_200;
/// Default unit identifier of a TCP device without a gateway.
const DEFAULT_TCP_UNIT: u8 = 255;
const DEFAULT_RTU_UNIT: u8 = 1;

/// Keys of a device. Each table that contains a device lists these keys itself: with serde's `flatten`, an error
/// would lose its position and the list of known keys.
pub struct ModbusDeviceKeys {
    pub serial: Option<PathBuf>,
    pub serial_id: Option<String>,
    pub baud: Option<u32>,
    pub parity: Option<Parity>,
    pub tcp: Option<HostPort>,
    pub framing: Option<Framing>,
    pub unit: Option<u8>,
    pub timeout_s: Option<f64>,
}

#[derive(Debug, Clone)]
pub struct ModbusDeviceConfig {
    pub line: ModbusLineConfig,
    /// Unit identifier: RTU 1 to 247; TCP 255, unless a gateway needs it to select the device.
    pub unit: u8,
    /// Maximum time until the reply.
    pub timeout: Duration,
}

impl ModbusDeviceConfig {
    /// Description with baud rate and unit identifier.
    pub fn describe(&self) -> String {
        format!("{}, unit {}", self.line.link.describe(), self.unit)
    }

    /// Settings of the device for a client that may access the registers of `access_list`.
    pub fn settings(&self, access_list: AccessList) -> DeviceSettings {
        DeviceSettings { unit: self.unit, timeout: self.timeout, access_list }
    }
}

impl TryFrom<ModbusDeviceKeys> for ModbusDeviceConfig {
    type Error = String;

    /// # Errors
    /// A message, if keys exclude each other or a value is out of range.
    fn try_from(keys: ModbusDeviceKeys) -> Result<Self, String> {
        let ModbusDeviceKeys { serial, serial_id, tcp, baud, .. } = keys;
        let link = LinkConfig::from_keys(LinkKeys { serial, serial_id, tcp, baud }, DEFAULT_BAUD)?;
        let line = ModbusLineConfig::from_keys(link, keys.framing, keys.parity)?;
        let default_unit = if line.framing == Framing::Tcp { DEFAULT_TCP_UNIT } else { DEFAULT_RTU_UNIT };
        let unit = keys.unit.unwrap_or(default_unit);
        if line.framing == Framing::Rtu && !(1..=247).contains(&unit) {
            return Err(format!("`unit` is {unit}; permitted on RTU: 1 to 247"));
        }
        Ok(Self { line, unit, timeout: crate::parse_timeout_s(keys.timeout_s)? })
    }
}
