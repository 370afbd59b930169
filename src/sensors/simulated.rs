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
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Simulated {
    #[serde(default)]
    speaks: Speaks,
    #[serde(default = "memory")]
    wire: String,
    /// Samples a second.
    #[serde(default = "usual_rate", deserialize_with = "rate")]
    rate_hz: f64,
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
        Self { speaks: Speaks::default(), wire: memory(), rate_hz: usual_rate() }
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
        let tongue = match self.speaks {
            Speaks::Serial => Tongue::Text,
            Speaks::SerialFrames => Tongue::Frames,
            Speaks::Modbus => {
                let when = Measures::WhenRead;
                let at = (when, Wire::of(&self.wire)?);
                let (sense, clock) = (self.sense(sensor, &view), view.clock);
                let driver = wires::modbus(at, sense, self.rate_hz, sensor, clock).await?;
                return Ok(Sensor::spawn(name, driver));
            }
            Speaks::Can => return self.on_can(sensor, view),
        };
        let at = (tongue, Wire::of(&self.wire)?);
        let (sense, clock) = (self.sense(sensor, &view), view.clock);
        let driver = wires::serial(at, sense, self.rate_hz, sensor, clock).await?;
        Ok(Sensor::spawn(name, driver))
    }

    /// One sample after the other; with each a period passes.
    fn sense(&self, sensor: &sensor::Sensor, view: &View) -> Box<dyn FnMut() -> Sensed + Send> {
        let (name, world, period_s) = (sensor.name.clone(), view.world.clone(), 1.0 / self.rate_hz);
        Box::new(move || {
            let mut world = world.lock().unwrap_or_else(PoisonError::into_inner);
            world.sense(&name, period_s).unwrap_or(Sensed::NoEcho)
        })
    }

    /// In memory, or on the CAN interface that `wire` names.
    fn on_can(&self, sensor: &sensor::Sensor, view: View) -> Result<Sensor, SensorError> {
        let (sense, clock) = (self.sense(sensor, &view), view.clock);
        let config = can::Config::of_simulated(&self.wire)?;
        if self.wire == memory() {
            let frames = can::simulated::frames(sense, clock.clone());
            let bus = Can::on_demand("the simulated sensor", frames);
            return Ok(config.over(bus, sensor, clock, None));
        }
        let bus = config.listen(clock.clone())?;
        let served = can::simulated::push(&self.wire, sense, self.rate_hz, clock.clone())?;
        Ok(config.over(bus, sensor, clock, Some(served)))
    }
}
