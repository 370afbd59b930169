//! Where a device is and how it is spoken to, as a file says it.

use std::path::PathBuf;
use std::time::Duration;

use super::line::{Framing, Line, Parity};
use crate::{HostPort, Named};

/// Baud rate as the Modbus serial line specification has it by default; the parity is in [`Line`].
const USUAL_BAUD: u32 = 19_200;
/// Where nobody forwards, a TCP device answers this one.
const USUAL_TCP_UNIT: u8 = 255;
const USUAL_RTU_UNIT: u8 = 1;

/// The keys of a device. Each table that has one lists them among its own: serde's `flatten` would lose
/// the place of a mistake and the keys that would have been right.
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
    /// RTU 1 to 247; TCP 255 unless a gateway forwards by it.
    pub unit: u8,
    /// How long an answer may take.
    pub timeout: Duration,
}

impl Device {
    /// With its speed and its unit.
    pub fn in_full(&self) -> String {
        format!("{}, unit {}", self.line.at.in_full(), self.unit)
    }
}

impl TryFrom<DeviceKeys> for Device {
    type Error = String;

    /// # Errors
    /// What does not go together or lies outside its bounds, in words.
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
