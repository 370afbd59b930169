//! Sensors that are simulated: one list of what they speak, and of the wires between the daemon and
//! them.

use std::sync::{Arc, Mutex};

use serde::Deserialize;

use super::{Sensor, SensorError};
use crate::base::Clock;
use crate::record::sensor;
use crate::world::World;

/// `[sensor.simulated]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Simulated {
    #[serde(default)]
    speaks: Speaks,
    #[serde(default = "memory")]
    wire: String,
    /// Samples a second.
    #[serde(default = "usual_rate")]
    rate_hz: f64,
}

/// The list: a new simulated sensor is a line here and in the match below.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Speaks {
    #[default]
    Can,
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
    pub async fn open(&self, sensor: &sensor::Sensor, _view: View) -> Result<Sensor, SensorError> {
        Err(SensorError::Strange {
            text: format!(
                "{} ({:?} by {} at {} Hz)",
                sensor.name, self.speaks, self.wire, self.rate_hz
            ),
            remedy: "wait for it to be built".to_owned(),
        })
    }
}
