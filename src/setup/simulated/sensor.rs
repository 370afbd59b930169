//! Registry of simulated sensors and of the wires between them and the daemon; `[sensor.simulated]`.

use std::sync::{Arc, Mutex, PoisonError};

use devices::sensors::{Sensor, SensorError, can};
use link::Clock;
use link::can::Can;
use machine::record::sensor;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer};
use simulator::sensors::modbus::Measures;
use simulator::sensors::serial::Format;
use simulator::sensors::{Sense, can as simulated_can};
use simulator::{Sensed, World};

use super::sensor_wire::{self, Wire, data_sheet};

/// `[sensor.simulated]`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    #[serde(default)]
    speaks: Speaks,
    #[serde(default = "memory")]
    wire: String,
    /// Sample rate, samples per second.
    #[serde(default = "usual_rate", deserialize_with = "rate")]
    rate_hz: f64,
}

/// A simulated sensor. In memory it measures on request, and the world's time advances only by its samples. A
/// sensor that sends unsolicited samples over another wire measures in wall time: the world's time advances
/// with it, and a run is not reproducible.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "Keys")]
pub struct SimulatedSensor {
    way: Way,
    rate_hz: f64,
}

#[derive(Debug, Clone)]
enum Way {
    /// In memory, or on the CAN interface of this name.
    Can(String),
    Serial(Format, Wire),
    Modbus(Wire),
}

impl TryFrom<Keys> for SimulatedSensor {
    type Error = String;

    /// Converts the keys.
    ///
    /// # Errors
    /// The sensor does not support the wire.
    fn try_from(Keys { speaks, wire, rate_hz }: Keys) -> Result<Self, String> {
        let way = match speaks {
            Speaks::Can => Way::Can(wire),
            Speaks::Serial => Way::Serial(Format::Text, Wire::of(&wire)?),
            Speaks::SerialFrames => Way::Serial(Format::Frames, Wire::of(&wire)?),
            Speaks::Modbus => Way::Modbus(Wire::of(&wire)?.beyond_memory()?),
        };
        Ok(Self { way, rate_hz })
    }
}

fn rate<'de, D: Deserializer<'de>>(keys: D) -> Result<f64, D::Error> {
    let hz = f64::deserialize(keys)?;
    if (0.1..=1e5).contains(&hz) {
        return Ok(hz);
    }
    Err(D::Error::custom(format!("`rate_hz` is {hz}; it lies between 0.1 and 100000")))
}

/// Registry: a new simulated sensor is a line here and in the match below.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Speaks {
    #[default]
    Can,
    /// Lines of text.
    Serial,
    SerialFrames,
    Modbus,
}

impl Default for SimulatedSensor {
    fn default() -> Self {
        Self { way: Way::Can(memory()), rate_hz: usual_rate() }
    }
}

fn memory() -> String {
    "memory".to_owned()
}

fn usual_rate() -> f64 {
    1000.0
}

/// World and clock of a simulated sensor.
pub struct View {
    pub world: Arc<Mutex<World>>,
    pub clock: Arc<dyn Clock>,
}

impl SimulatedSensor {
    /// Starts the sensor and opens its driver. Call inside a tokio runtime.
    ///
    /// # Errors
    /// The wire or the driver cannot be opened.
    pub async fn open(&self, sensor: &sensor::Sensor, view: View) -> Result<Sensor, SensorError> {
        let name = sensor.name.as_str();
        let (sense, clock) = (self.sense(sensor, &view), view.clock.clone());
        match &self.way {
            Way::Can(wire) => self.on_can(wire, sensor, view),
            Way::Serial(format, wire) => {
                let at = (*format, *wire);
                let driver = sensor_wire::serial(at, sense, self.rate_hz, sensor, clock).await?;
                Ok(Sensor::spawn(name, driver))
            }
            Way::Modbus(wire) => {
                let at = (Measures::WhenRead, *wire);
                let driver = sensor_wire::modbus(at, sense, self.rate_hz, sensor, clock).await?;
                Ok(Sensor::spawn(name, driver))
            }
        }
    }

    /// Source of samples; each sample advances the world by one period.
    fn sense(&self, sensor: &sensor::Sensor, view: &View) -> Sense {
        let (name, world, period_s) = (sensor.name.clone(), view.world.clone(), 1.0 / self.rate_hz);
        Box::new(move || {
            let mut world = world.lock().unwrap_or_else(PoisonError::into_inner);
            world.sense(&name, period_s).unwrap_or(Sensed::NoEcho)
        })
    }

    fn on_can(
        &self,
        wire: &str,
        sensor: &sensor::Sensor,
        view: View,
    ) -> Result<Sensor, SensorError> {
        let (sense, clock) = (self.sense(sensor, &view), view.clock);
        let sheet = format!("interface = \"{wire}\"\n{}", simulated_can::DATA_SHEET);
        let config: can::Config = data_sheet(&sheet)?;
        if wire == memory() {
            let frames = simulated_can::frames(sense, clock.clone());
            let bus = Can::on_demand("the simulated sensor", frames);
            return Ok(config.over(bus, sensor, clock, None));
        }
        let bus = config.listen(clock.clone())?;
        let served = simulated_can::push(wire, sense, self.rate_hz, clock.clone())?;
        Ok(config.over(bus, sensor, clock, Some(served)))
    }
}
