//! Thermometers of a machine, read while a run measures.

use std::sync::{Arc, Mutex, PoisonError};

use devices::sensors::thermometer::{
    self, SimulatedTemperatureSource, ThermometerConfig, ThermometerError, ThermometerPoller,
};
use link::LinkMode;
use simulator::SimulatedWorld;

/// Thermometers of the machine file, and the world that simulated ones measure.
pub struct Thermometers {
    entries: Vec<ThermometerConfig>,
    world: Option<Arc<Mutex<SimulatedWorld>>>,
}

impl Thermometers {
    /// Creates the thermometers of `entries`; none during the replay of a capture, which does not contain their
    /// values.
    pub(super) fn new(entries: &[ThermometerConfig], world: Option<Arc<Mutex<SimulatedWorld>>>) -> Self {
        let is_live = !LinkMode::current().is_replayed();
        Self { entries: entries.iter().filter(|_| is_live).cloned().collect(), world }
    }

    /// Reads all thermometers until the returned value is dropped. Call inside a tokio runtime.
    pub fn start_polling(&self) -> ThermometerPoller {
        ThermometerPoller::start(&self.entries, |name| self.simulated_source(name))
    }

    /// Reads each thermometer once, °C.
    pub async fn read_once(&self) -> Vec<(&ThermometerConfig, Result<f64, ThermometerError>)> {
        thermometer::read_thermometers_once(&self.entries, |name| self.simulated_source(name)).await
    }

    /// Source of the temperature of the thermometer `name` in the world; `None`: there is no simulated world.
    fn simulated_source(&self, name: &str) -> Option<SimulatedTemperatureSource> {
        let (world, name) = (self.world.clone()?, name.to_owned());
        Some(Box::new(move || world.lock().unwrap_or_else(PoisonError::into_inner).temperature_c(&name)))
    }
}
