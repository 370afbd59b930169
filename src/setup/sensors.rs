//! Sensors of a machine, opened when a run needs them.

use std::ops::Deref;
use std::sync::{Arc, Mutex, PoisonError};

use super::machine_file::{Encoder, Reached, SensorEntry};
use super::simulated::View;
use super::{MachineFile, SetupError, world};
use devices::sensors::{Sensor, SensorError};
use link::clock::HostClock;
use link::{Clock, SharedPorts, Talk, Wiring};
use simulator::World;

/// Opens the sensor `name` alone, without its machine. A simulated sensor measures the world before any motion.
/// Call inside a tokio runtime.
///
/// # Errors
/// There is no sensor of this name, the simulated world cannot be built, or the sensor cannot be opened.
pub async fn sensor(file: &MachineFile, name: &str) -> Result<Mounted, SetupError> {
    let alone = Sensors::none(Arc::new(HostClock::start())).of(&file.sensors, file.encoder);
    let simulated = |entry: &&SensorEntry| matches!(entry.reached, Reached::Simulated(_));
    let named = file.sensors.iter().find(|entry| entry.sensor.name == name);
    let sensors = match named.filter(simulated) {
        Some(_) => alone.looking_at(Arc::new(Mutex::new(world(file)?))),
        None => alone,
    };
    Ok(sensors.open(name).await?)
}

/// Sensors of the machine file, and the world that simulated sensors measure.
pub struct Sensors {
    entries: Vec<SensorEntry>,
    encoder: Option<Encoder>,
    clock: Arc<dyn Clock>,
    world: Option<Arc<Mutex<World>>>,
    /// Wiring of the control, also for sensors, which are opened later.
    wiring: Wiring,
    /// Ports that several sensors may share.
    ports: SharedPorts,
}

impl Sensors {
    /// No sensors.
    pub(super) fn none(clock: Arc<dyn Clock>) -> Self {
        let (entries, ports) = (Vec::new(), SharedPorts::default());
        Self { entries, encoder: None, clock, world: None, wiring: Wiring::current(), ports }
    }

    pub(super) fn of(self, entries: &[SensorEntry], encoder: Option<Encoder>) -> Self {
        Self { entries: entries.to_vec(), encoder, ..self }
    }

    /// Sets the simulated world that simulated sensors measure.
    pub(super) fn looking_at(self, world: Arc<Mutex<World>>) -> Self {
        Self { world: Some(world), ..self }
    }

    /// Meaning of the counts in the samples of the sensor `name`; `None`: they contain no counts.
    pub fn encoder_scale(&self, name: &str) -> Option<EncoderScale> {
        let entry = self.entries.iter().find(|entry| entry.sensor.name == name)?;
        Some(EncoderScale { encoder: self.encoder?, round: entry.reached.encoder_round()? })
    }

    /// Opens the sensor of this name. A sensor in the spindle replaces the probe until dropped. Call inside a
    /// tokio runtime.
    ///
    /// # Errors
    /// There is no such sensor, or it cannot be opened.
    pub async fn open(&self, name: &str) -> Result<Mounted, SensorError> {
        let sensor = self.opened(name).await?;
        let named = self.entries.iter().find(|entry| entry.sensor.name == name);
        let in_spindle = named.is_some_and(|entry| entry.sensor.mount.is_spindle());
        let world = self.world.clone().filter(|_| in_spindle);
        if let Some(world) = &world {
            without_probe(world, true);
        }
        Ok(Mounted { sensor, world })
    }

    async fn opened(&self, name: &str) -> Result<Sensor, SensorError> {
        let named = self.entries.iter().find(|entry| entry.sensor.name == name);
        let SensorEntry { sensor, reached, .. } =
            named.ok_or_else(|| SensorError::Unknown { name: name.to_owned() })?;
        let talk = Talk::over(&self.wiring, &format!("sensor {name}"));
        if talk.is_replayed() {
            return Ok(Sensor::replayed(name, talk));
        }
        let opened = match (reached, &self.world) {
            (Reached::Simulated(simulated), Some(world)) => {
                simulated.open(sensor, view(world)).await
            }
            (Reached::Real(real), _) => real.open(sensor, self.clock.clone(), &self.ports).await,
            (Reached::Simulated(_), None) => {
                Err(SensorError::NothingToSee { name: name.to_owned() })
            }
        };
        opened?.captured(talk).await
    }
}

/// Scale of a rotary encoder's counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EncoderScale {
    pub encoder: Encoder,
    /// Number of counts after which the count wraps.
    pub round: u64,
}

/// An open sensor of a run.
pub struct Mounted {
    sensor: Sensor,
    world: Option<Arc<Mutex<World>>>,
}

impl Deref for Mounted {
    type Target = Sensor;

    fn deref(&self) -> &Sensor {
        &self.sensor
    }
}

impl Drop for Mounted {
    fn drop(&mut self) {
        if let Some(world) = &self.world {
            without_probe(world, false);
        }
    }
}

fn without_probe(world: &Mutex<World>, away: bool) {
    world.lock().unwrap_or_else(PoisonError::into_inner).without_probe(away);
}

fn view(world: &Arc<Mutex<World>>) -> View {
    View { world: world.clone(), clock: Arc::new(WorldClock(world.clone())) }
}

/// Clock of simulated time.
struct WorldClock(Arc<Mutex<World>>);

impl Clock for WorldClock {
    fn now_s(&self) -> f64 {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).time_s()
    }
}
