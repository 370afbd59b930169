//! Wires between a simulated sensor and its driver.

use std::sync::Arc;

use devices::sensors::SensorError;
use devices::sensors::modbus::{self, ModbusSensorDriver};
use devices::sensors::serial::{self, SerialDriver};
use link::{Clock, SharedPorts};
use machine::record::sensor;
use serde::de::DeserializeOwned;
use simulator::sensor_devices::modbus::{DATA_SHEET_TOML, SampleTiming, serve_on_pty, serve_on_tcp};
use simulator::sensor_devices::serial::{OutputFormat, REQUEST_KEY_TOML, send_on_pty, send_on_tcp, serve_on_demand};
use simulator::sensor_devices::{SampleSource, serial as simulated_serial};

/// Wire of the operating system between the daemon and a simulated sensor; both are in this process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SensorWire {
    Pty,
    Tcp,
}

impl SensorWire {
    /// The wire named `name`; `None`: in memory, where simulated time advances only with the samples that are
    /// requested.
    ///
    /// # Errors
    /// An unknown name.
    pub fn from_name(name: &str) -> Result<Option<Self>, String> {
        match name {
            "memory" => Ok(None),
            "pty" => Ok(Some(Self::Pty)),
            "tcp" => Ok(Some(Self::Tcp)),
            _ => Err(format!("`wire` is `{name}`; it must be `memory`, `pty` or `tcp`")),
        }
    }
}

/// A driver's configuration from the data sheet of its simulated sensor.
///
/// # Errors
/// None in practice: tests open each configuration.
pub(super) fn parse_driver_config<T: DeserializeOwned>(keys: &str) -> Result<T, SensorError> {
    toml::from_str(keys).map_err(|error| SensorError::InvalidData {
        text: error.to_string(),
        remedy: "report this fault to the developers".to_owned(),
    })
}

/// Starts a sensor on a serial line with `rate_hz` samples per second, and its driver. In memory the sensor
/// sends a sample on request, on another wire unsolicited. Call inside a tokio runtime.
///
/// # Errors
/// The wire or the driver cannot be opened.
pub async fn start_serial_sensor(
    format: OutputFormat,
    wire: Option<SensorWire>,
    next_sample: SampleSource,
    rate_hz: f64,
    sensor: &sensor::Sensor,
    clock: Arc<dyn Clock>,
) -> Result<SerialDriver, SensorError> {
    let sheet = simulated_serial::data_sheet_toml(format);
    let (at, client_side) = match wire {
        None => {
            let config: serial::SerialConfig =
                parse_driver_config(&format!("serial = \"memory\"\n{REQUEST_KEY_TOML}{sheet}"))?;
            let stream = serve_on_demand(format, next_sample);
            return Ok(SerialDriver::from_stream(stream, config, sensor, clock, rate_hz));
        }
        Some(SensorWire::Pty) => send_on_pty(format, next_sample, rate_hz)?,
        Some(SensorWire::Tcp) => send_on_tcp(format, next_sample, rate_hz)?,
    };
    let config: serial::SerialConfig = parse_driver_config(&format!("{}{sheet}", at.to_toml()))?;
    let serial = SerialDriver::open(config, sensor, clock, SharedPorts::default()).await;
    // The driver holds the pseudo-terminal open now.
    drop(client_side);
    serial
}

/// Starts a simulated sensor with Modbus registers and `rate_hz` samples per second, and opens its driver. Call inside
/// a tokio runtime.
///
/// # Errors
/// The wire or the driver cannot be opened.
pub async fn start_modbus_sensor(
    timing: SampleTiming,
    wire: SensorWire,
    next_sample: SampleSource,
    rate_hz: f64,
    sensor: &sensor::Sensor,
    clock: Arc<dyn Clock>,
) -> Result<ModbusSensorDriver, SensorError> {
    let (at, client_side) = match wire {
        SensorWire::Pty => serve_on_pty(timing, next_sample, rate_hz)?,
        SensorWire::Tcp => serve_on_tcp(timing, next_sample, rate_hz)?,
    };
    let parity = if matches!(at, link::LinkConfig::Tcp(_)) { "" } else { "parity = \"none\"\n" };
    let keys = format!("{}{parity}rate_hz = {rate_hz}\n{DATA_SHEET_TOML}", at.to_toml());
    let config: modbus::ModbusSensorConfig = parse_driver_config(&keys)?;
    let simulated_hz = (timing == SampleTiming::WhenRead).then_some(rate_hz);
    let registers = ModbusSensorDriver::open(config, sensor, clock, simulated_hz).await;
    drop(client_side);
    registers
}
