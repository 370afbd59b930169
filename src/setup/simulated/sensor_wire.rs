//! Wires between a simulated sensor and its driver.

use std::sync::Arc;

use devices::sensors::SensorError;
use devices::sensors::modbus::{self, Registers};
use devices::sensors::serial::{self, Serial};
use link::{Clock, SharedPorts};
use machine::record::sensor;
use serde::de::DeserializeOwned;
use simulator::sensors::modbus::{DATA_SHEET, Measures, serve_on_pty, serve_on_tcp};
use simulator::sensors::serial::{Format, REQUEST, on_demand, send_on_pty, send_on_tcp};
use simulator::sensors::{Sense, serial as simulated_serial};

/// Wire between the daemon and a simulated sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wire {
    /// Inside this process: simulated time advances only with the samples that are requested.
    Memory,
    Pty,
    Tcp,
}

impl Wire {
    /// The wire named `name`.
    ///
    /// # Errors
    /// An unknown name.
    pub fn of(name: &str) -> Result<Self, String> {
        match name {
            "memory" => Ok(Self::Memory),
            "pty" => Ok(Self::Pty),
            "tcp" => Ok(Self::Tcp),
            _ => Err(format!("`wire` is `{name}`; it is `memory`, `pty` or `tcp`")),
        }
    }

    /// The same wire, if it is not in memory.
    ///
    /// # Errors
    /// `Memory`: registers are served over TCP or a pseudo-terminal only.
    pub fn beyond_memory(self) -> Result<Self, String> {
        match self {
            Self::Memory => {
                Err("`speaks = \"modbus\"` needs `wire = \"tcp\"` or `wire = \"pty\"`".to_owned())
            }
            other => Ok(other),
        }
    }
}

/// A driver's configuration from the data sheet of its simulated sensor.
///
/// # Errors
/// None in practice: tests open each configuration.
pub(super) fn data_sheet<T: DeserializeOwned>(keys: &str) -> Result<T, SensorError> {
    toml::from_str(keys).map_err(|error| SensorError::UnexpectedDevice {
        text: error.to_string(),
        remedy: "report it".to_owned(),
    })
}

/// Starts a sensor on a serial line with `rate_hz` samples per second, and its driver. In memory the sensor
/// sends a sample on request, on another wire unsolicited. Call inside a tokio runtime.
///
/// # Errors
/// The wire or the driver cannot be opened.
pub async fn serial(
    (format, wire): (Format, Wire),
    sense: Sense,
    rate_hz: f64,
    sensor: &sensor::Sensor,
    clock: Arc<dyn Clock>,
) -> Result<Serial, SensorError> {
    let (at, keep) = match wire {
        Wire::Memory => {
            let sheet = simulated_serial::data_sheet(format);
            let config: serial::Config =
                data_sheet(&format!("serial = \"memory\"\n{REQUEST}{sheet}"))?;
            let flow = on_demand(format, sense);
            return Ok(Serial::over(flow, config, sensor, clock, rate_hz));
        }
        Wire::Pty => send_on_pty(format, sense, rate_hz)?,
        Wire::Tcp => send_on_tcp(format, sense, rate_hz)?,
    };
    let sheet = simulated_serial::data_sheet(format);
    let config: serial::Config = data_sheet(&format!("{}{sheet}", at.to_toml()))?;
    let serial = Serial::open(config, sensor, clock, SharedPorts::default()).await;
    // The driver holds the pseudo-terminal open now.
    drop(keep);
    serial
}

/// Starts a sensor behind registers with `rate_hz` samples per second, and its driver. Call inside a tokio
/// runtime.
///
/// # Errors
/// The wire or the driver cannot be opened; the wire is in memory (see [`Wire::beyond_memory`]).
pub async fn modbus(
    (measures, wire): (Measures, Wire),
    sense: Sense,
    rate_hz: f64,
    sensor: &sensor::Sensor,
    clock: Arc<dyn Clock>,
) -> Result<Registers, SensorError> {
    let (at, keep) = match wire {
        Wire::Memory => {
            return Err(SensorError::UnexpectedDevice {
                text: "registers are not served in memory".to_owned(),
                remedy: "take `wire = \"tcp\"`".to_owned(),
            });
        }
        Wire::Pty => serve_on_pty(measures, sense, rate_hz)?,
        Wire::Tcp => serve_on_tcp(measures, sense, rate_hz)?,
    };
    let parity = if matches!(at, link::Named::Tcp(_)) { "" } else { "parity = \"none\"\n" };
    let keys = format!("{}{parity}rate_hz = {rate_hz}\n{DATA_SHEET}", at.to_toml());
    let config: modbus::Config = data_sheet(&keys)?;
    let simulated_hz = (measures == Measures::WhenRead).then_some(rate_hz);
    let registers = Registers::open(config, sensor, clock, simulated_hz).await;
    drop(keep);
    registers
}
