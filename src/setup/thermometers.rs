//! Thermometers of a machine, read while a run measures.

use std::sync::{Arc, Mutex, PoisonError};

use devices::sensors::thermometer::{self, Entry, SimulatedTemperature, ThermometerError, Watch};
use link::Wiring;
use simulator::World;

/// Thermometers of the machine file, and the world that simulated ones measure.
pub struct Thermometers {
    entries: Vec<Entry>,
    world: Option<Arc<Mutex<World>>>,
}

impl Thermometers {
    /// No thermometers during the replay of a capture, which does not contain their values.
    pub(super) fn of(entries: &[Entry], world: Option<Arc<Mutex<World>>>) -> Self {
        let there = !Wiring::current().is_replayed();
        Self { entries: entries.iter().filter(|_| there).cloned().collect(), world }
    }

    /// Reads all thermometers until the returned value is dropped. Call inside a tokio runtime.
    pub fn watch(&self) -> Watch {
        Watch::of(&self.entries, |name| self.feel(name))
    }

    /// Reads each thermometer once.
    pub async fn once(&self) -> Vec<(&Entry, Result<f64, ThermometerError>)> {
        thermometer::once(&self.entries, |name| self.feel(name)).await
    }

    fn feel(&self, name: &str) -> Option<SimulatedTemperature> {
        let (world, name) = (self.world.clone()?, name.to_owned());
        Some(Box::new(move || {
            world.lock().unwrap_or_else(PoisonError::into_inner).temperature_c(&name)
        }))
    }
}
