//! Registry of simulated sensors and of the wires between them and the daemon; `[sensor.simulated]`.

use std::sync::{Arc, Mutex, PoisonError};

use devices::sensors::{SensorError, SensorHandle, can};
use link::Clock;
use link::can::CanReceiver;
use machine::record::sensor;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer};
use simulator::sensor_devices::modbus::SampleTiming;
use simulator::sensor_devices::serial::OutputFormat;
use simulator::sensor_devices::{SampleSource, can as simulated_can};
use simulator::{SensorOutput, SimulatedWorld};

use super::sensor_wire::{self, SensorWire, parse_driver_config};

/// `[sensor.simulated]`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SimulatedSensorKeys {
    #[serde(default, rename = "speaks")]
    protocol: SensorProtocol,
    /// `memory`, `pty` or `tcp`; for CAN, `memory` or the name of a CAN interface.
    #[serde(default = "default_wire")]
    wire: String,
    /// Sample rate, samples per second.
    #[serde(default = "default_rate_hz", deserialize_with = "parse_rate_hz")]
    rate_hz: f64,
}

/// A simulated sensor. In memory it measures on request, and the world's time advances only by its samples. A
/// sensor that sends unsolicited samples over another wire measures in wall time: the world's time advances
/// with it, and a run is not reproducible.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "SimulatedSensorKeys")]
pub struct SimulatedSensorConfig {
    interface: SensorInterface,
    sample_rate_hz: f64,
}

/// Protocol of a simulated sensor, and where its driver reaches it.
#[derive(Debug, Clone)]
enum SensorInterface {
    /// `memory`, or the name of the CAN interface.
    Can(String),
    /// Text or frames of this format, in memory (`None`) or on a wire.
    Serial(OutputFormat, Option<SensorWire>),
    Modbus(SensorWire),
}

impl TryFrom<SimulatedSensorKeys> for SimulatedSensorConfig {
    type Error = String;

    /// Converts the keys of `[sensor.simulated]`.
    ///
    /// # Errors
    /// The sensor does not support the wire.
    fn try_from(SimulatedSensorKeys { protocol, wire, rate_hz }: SimulatedSensorKeys) -> Result<Self, String> {
        let interface = match protocol {
            SensorProtocol::Can => SensorInterface::Can(wire),
            SensorProtocol::Serial => SensorInterface::Serial(OutputFormat::TextLines, SensorWire::from_name(&wire)?),
            SensorProtocol::SerialFrames => {
                SensorInterface::Serial(OutputFormat::BinaryFrames, SensorWire::from_name(&wire)?)
            }
            SensorProtocol::Modbus => SensorInterface::Modbus(
                SensorWire::from_name(&wire)?
                    .ok_or("`speaks = \"modbus\"` requires `wire = \"tcp\"` or `wire = \"pty\"`")?,
            ),
        };
        Ok(Self { interface, sample_rate_hz: rate_hz })
    }
}

fn parse_rate_hz<'de, D: Deserializer<'de>>(keys: D) -> Result<f64, D::Error> {
    let hz = f64::deserialize(keys)?;
    if (0.1..=1e5).contains(&hz) {
        return Ok(hz);
    }
    Err(D::Error::custom(format!("`rate_hz` is {hz}; it must be between 0.1 and 100000")))
}

/// Protocol of a simulated sensor. Registry: a new simulated sensor is a line here and in the match below.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum SensorProtocol {
    #[default]
    Can,
    /// Lines of text on a serial line.
    Serial,
    /// Binary frames on a serial line.
    SerialFrames,
    Modbus,
}

impl Default for SimulatedSensorConfig {
    fn default() -> Self {
        Self { interface: SensorInterface::Can(default_wire()), sample_rate_hz: default_rate_hz() }
    }
}

fn default_wire() -> String {
    "memory".to_owned()
}

fn default_rate_hz() -> f64 {
    1000.0
}

/// Clock of simulated time.
struct WorldClock(Arc<Mutex<SimulatedWorld>>);

impl Clock for WorldClock {
    fn now_s(&self) -> f64 {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).time_s()
    }
}

impl SimulatedSensorConfig {
    /// Starts the sensor and opens its driver. Call inside a tokio runtime.
    ///
    /// # Errors
    /// The wire or the driver cannot be opened.
    pub async fn start_and_open_driver(
        &self,
        sensor: &sensor::Sensor,
        world: &Arc<Mutex<SimulatedWorld>>,
    ) -> Result<SensorHandle, SensorError> {
        let name = sensor.name.as_str();
        let (next_sample, clock) = (self.sample_source(name, world.clone()), Arc::new(WorldClock(world.clone())));
        match &self.interface {
            SensorInterface::Can(wire) => self.open_can(wire, next_sample, sensor, clock),
            SensorInterface::Serial(format, wire) => {
                let driver =
                    sensor_wire::start_serial_sensor(*format, *wire, next_sample, self.sample_rate_hz, sensor, clock)
                        .await?;
                Ok(SensorHandle::spawn(name, driver))
            }
            SensorInterface::Modbus(wire) => {
                let driver = sensor_wire::start_modbus_sensor(
                    SampleTiming::WhenRead,
                    *wire,
                    next_sample,
                    self.sample_rate_hz,
                    sensor,
                    clock,
                )
                .await?;
                Ok(SensorHandle::spawn(name, driver))
            }
        }
    }

    /// Source of samples; each sample first advances the world by one period of the sensor's clock.
    fn sample_source(&self, name: &str, world: Arc<Mutex<SimulatedWorld>>) -> SampleSource {
        let (name, period_s) = (name.to_owned(), 1.0 / self.sample_rate_hz);
        Box::new(move || {
            let mut world = world.lock().unwrap_or_else(PoisonError::into_inner);
            world.sample_after(&name, period_s).unwrap_or(SensorOutput::NoEcho)
        })
    }

    /// Opens the driver of a sensor on CAN: in memory, or on the CAN interface `wire`.
    fn open_can(
        &self,
        wire: &str,
        next_sample: SampleSource,
        sensor: &sensor::Sensor,
        clock: Arc<dyn Clock>,
    ) -> Result<SensorHandle, SensorError> {
        let data_sheet = format!("interface = \"{wire}\"\n{}", simulated_can::DATA_SHEET_TOML);
        let config: can::CanConfig = parse_driver_config(&data_sheet)?;
        if wire == default_wire() {
            let frames = simulated_can::frame_generator(next_sample, clock.clone());
            let bus = CanReceiver::from_generator("the simulated sensor", frames);
            return Ok(config.spawn_sensor(bus, sensor, clock, None));
        }
        let bus = config.open_bus(clock.clone())?;
        let served = simulated_can::spawn_frame_sender(wire, next_sample, self.sample_rate_hz, clock.clone())?;
        Ok(config.spawn_sensor(bus, sensor, clock, Some(served)))
    }
}
