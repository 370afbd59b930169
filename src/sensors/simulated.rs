//! Sensors that are simulated: one list of what they speak, and of the wires between the daemon and
//! them.

use std::sync::{Arc, Mutex, PoisonError};

use serde::de::Error as _;
use serde::{Deserialize, Deserializer};

use super::modbus::simulated::Measures;
use super::wires::{self, Tongue, Wire};
use super::{Sensor, SensorError, can};
use crate::base::Clock;
use crate::link::can::Can;
use crate::record::sensor;
use crate::world::{Sensed, World};

/// `[sensor.simulated]`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    #[serde(default)]
    speaks: Speaks,
    #[serde(default = "memory")]
    wire: String,
    /// Samples a second.
    #[serde(default = "usual_rate", deserialize_with = "rate")]
    rate_hz: f64,
}

/// A simulated sensor. In memory it measures when it is asked, and the world's time goes on by its
/// samples alone. Whatever sends by itself over another wire measures in wall time: then the world's
/// time goes on with it, and a run is not the same twice.
#[derive(Debug, Clone, Deserialize)]
#[serde(try_from = "Keys")]
pub struct Simulated {
    way: Way,
    rate_hz: f64,
}

#[derive(Debug, Clone)]
enum Way {
    /// In memory, or on the interface of this name.
    Can(String),
    Serial(Tongue, Wire),
    Modbus(Wire),
}

impl TryFrom<Keys> for Simulated {
    type Error = String;

    /// # Errors
    /// A wire that it does not have, in words.
    fn try_from(Keys { speaks, wire, rate_hz }: Keys) -> Result<Self, String> {
        let way = match speaks {
            Speaks::Can => Way::Can(wire),
            Speaks::Serial => Way::Serial(Tongue::Text, Wire::of(&wire)?),
            Speaks::SerialFrames => Way::Serial(Tongue::Frames, Wire::of(&wire)?),
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

/// The list: a new simulated sensor is a line here and in the match below.
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

impl Default for Simulated {
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

/// What a simulated sensor looks at.
pub struct View {
    pub world: Arc<Mutex<World>>,
    pub clock: Arc<dyn Clock>,
}

impl Simulated {
    /// Start it and open its driver. Call inside a tokio runtime.
    ///
    /// # Errors
    /// What opening says.
    pub async fn open(&self, sensor: &sensor::Sensor, view: View) -> Result<Sensor, SensorError> {
        let name = sensor.name.as_str();
        let (sense, clock) = (self.sense(sensor, &view), view.clock.clone());
        match &self.way {
            Way::Can(wire) => self.on_can(wire, sensor, view),
            Way::Serial(tongue, wire) => {
                let at = (*tongue, *wire);
                let driver = wires::serial(at, sense, self.rate_hz, sensor, clock).await?;
                Ok(Sensor::spawn(name, driver))
            }
            Way::Modbus(wire) => {
                let at = (Measures::WhenRead, *wire);
                let driver = wires::modbus(at, sense, self.rate_hz, sensor, clock).await?;
                Ok(Sensor::spawn(name, driver))
            }
        }
    }

    /// One sample after the other; with each a period passes.
    fn sense(&self, sensor: &sensor::Sensor, view: &View) -> Box<dyn FnMut() -> Sensed + Send> {
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
        let config = can::Config::of_simulated(wire)?;
        if wire == memory() {
            let frames = can::simulated::frames(sense, clock.clone());
            let bus = Can::on_demand("the simulated sensor", frames);
            return Ok(config.over(bus, sensor, clock, None));
        }
        let bus = config.listen(clock.clone())?;
        let served = can::simulated::push(wire, sense, self.rate_hz, clock.clone())?;
        Ok(config.over(bus, sensor, clock, Some(served)))
    }
}
