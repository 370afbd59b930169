//! Address and settings of a Modbus device, as written in a file.

use std::path::PathBuf;
use std::time::Duration;

use super::line::{Framing, Line, Parity};
use crate::{HostPort, Named};

/// Default baud rate of the Modbus serial line specification; the default parity is in [`Line`].
const USUAL_BAUD: u32 = 19_200;
/// Default unit identifier of a TCP device without a gateway.
const USUAL_TCP_UNIT: u8 = 255;
const USUAL_RTU_UNIT: u8 = 1;

/// Keys of a device. Each table that contains a device lists these keys itself: with serde's `flatten`, an error
/// would lose its position and the list of known keys.
pub struct DeviceKeys {
    pub serial: Option<PathBuf>,
    pub serial_id: Option<String>,
    pub baud: Option<u32>,
    pub parity: Option<Parity>,
    pub tcp: Option<HostPort>,
    pub framing: Option<Framing>,
    pub unit: Option<u8>,
    pub timeout_s: f64,
}

#[derive(Debug, Clone)]
pub struct Device {
    pub line: Line,
    /// Unit identifier: RTU 1 to 247; TCP 255 unless a gateway forwards by it.
    pub unit: u8,
    /// Maximum time until the reply.
    pub timeout: Duration,
}

impl Device {
    /// Description with baud rate and unit identifier.
    pub fn in_full(&self) -> String {
        format!("{}, unit {}", self.line.at.in_full(), self.unit)
    }
}

impl TryFrom<DeviceKeys> for Device {
    type Error = String;

    /// # Errors
    /// Keys that exclude each other, or a value out of range; as a message.
    fn try_from(keys: DeviceKeys) -> Result<Self, String> {
        let at = Named::of((keys.serial, keys.serial_id, keys.tcp), keys.baud, USUAL_BAUD)?;
        let line = Line::spoken(at, keys.framing, keys.parity)?;
        let usual = if line.framing == Framing::Tcp { USUAL_TCP_UNIT } else { USUAL_RTU_UNIT };
        let unit = keys.unit.unwrap_or(usual);
        if line.framing == Framing::Rtu && !(1..=247).contains(&unit) {
            return Err(format!("`unit` is {unit}; on RTU a device has a number from 1 to 247"));
        }
        Ok(Self { line, unit, timeout: crate::timeout(keys.timeout_s)? })
    }
}
