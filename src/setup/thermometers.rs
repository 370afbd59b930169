//! The thermometers of a machine, read while a run measures.

use std::sync::{Arc, Mutex, PoisonError};

use devices::sensors::thermometer::{self, Entry, Feel, ThermometerError, Watch};
use link::Wiring;
use simulator::World;

/// What the machine file names, and what simulated ones feel.
pub struct Thermometers {
    entries: Vec<Entry>,
    world: Option<Arc<Mutex<World>>>,
}

impl Thermometers {
    /// None where a capture answers instead of the machine: what they said is not in it.
    pub(super) fn of(entries: &[Entry], world: Option<Arc<Mutex<World>>>) -> Self {
        let there = !Wiring::current().is_replayed();
        Self { entries: entries.iter().filter(|_| there).cloned().collect(), world }
    }

    /// Read all of them until what this gives is dropped. Call inside a tokio runtime.
    pub fn watch(&self) -> Watch {
        Watch::of(&self.entries, |name| self.feel(name))
    }

    /// Ask each once.
    pub async fn once(&self) -> Vec<(&Entry, Result<f64, ThermometerError>)> {
        thermometer::once(&self.entries, |name| self.feel(name)).await
    }

    fn feel(&self, name: &str) -> Option<Feel> {
        let (world, name) = (self.world.clone()?, name.to_owned());
        Some(Box::new(move || {
            world.lock().unwrap_or_else(PoisonError::into_inner).temperature_c(&name)
        }))
    }
}
