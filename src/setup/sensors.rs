//! Sensors of a machine, opened when a run needs them.

use std::ops::Deref;
use std::sync::{Arc, Mutex, PoisonError};

use super::machine_file::{AxisEncoder, SensorConnection, SensorEntry};
use super::{MachineFile, SetupError, build_world};
use devices::sensors::{SensorError, SensorHandle};
use link::clock::HostClock;
use link::{Clock, LinkMode, SensorRequestCapture, SharedPorts};
use simulator::SimulatedWorld;

/// Opens the sensor `name` alone, without its machine. A simulated sensor measures the initial simulated world.
/// Call inside a tokio runtime.
///
/// # Errors
/// There is no sensor of this name, the simulated world cannot be built, or the sensor cannot be opened.
pub async fn open_sensor(file: &MachineFile, name: &str) -> Result<OpenSensor, SetupError> {
    let mut named = file.sensors.iter().filter(|entry| entry.sensor.name == name);
    let is_simulated = named.any(|entry| matches!(entry.connection, SensorConnection::Simulated(_)));
    let world = if is_simulated { Some(Arc::new(Mutex::new(build_world(file)?))) } else { None };
    let clock = Arc::new(HostClock::start());
    Ok(SensorOpener::new(&file.sensors, file.encoder, clock, world).open(name).await?)
}

/// Opens the sensors of the machine file when a run needs them; simulated ones measure `world`.
pub struct SensorOpener {
    entries: Vec<SensorEntry>,
    encoder: Option<AxisEncoder>,
    /// Clock of the samples of real sensors; simulated sensors use the time of `world`.
    clock: Arc<dyn Clock>,
    /// World that simulated sensors measure; `None`: simulated sensors cannot be opened.
    world: Option<Arc<Mutex<SimulatedWorld>>>,
    /// Mode of the links when the machine was opened; the sensors are opened later, with the same mode.
    link_mode: LinkMode,
    /// Ports that several sensors may share.
    ports: SharedPorts,
}

impl SensorOpener {
    /// Opener for the sensors of `entries`; no sensor is opened yet. Simulated sensors measure `world`.
    pub(super) fn new(
        entries: &[SensorEntry],
        encoder: Option<AxisEncoder>,
        clock: Arc<dyn Clock>,
        world: Option<Arc<Mutex<SimulatedWorld>>>,
    ) -> Self {
        let (wiring, ports) = (LinkMode::current(), SharedPorts::default());
        Self { entries: entries.to_vec(), encoder, clock, world, link_mode: wiring, ports }
    }

    /// Scale of the encoder counts in the samples of the sensor `name`; `None`: there is no such sensor, or its
    /// samples contain no counts.
    pub fn encoder_scale(&self, name: &str) -> Option<EncoderScale> {
        let entry = self.entry(name)?;
        Some(EncoderScale { encoder: self.encoder?, wrap_count: entry.connection.encoder_wrap_count()? })
    }

    /// Opens the sensor of this name, or replays it from a capture. On a simulated machine, a sensor in the spindle
    /// replaces the probe until the returned value is dropped. Call inside a tokio runtime.
    ///
    /// # Errors
    /// There is no such sensor, or it cannot be opened.
    pub async fn open(&self, name: &str) -> Result<OpenSensor, SensorError> {
        let sensor = self.open_or_replay_sensor(name).await?;
        let in_spindle = self.entry(name).is_some_and(|entry| entry.sensor.mount.is_spindle());
        let world = self.world.clone().filter(|_| in_spindle);
        if let Some(world) = &world {
            set_probe_removed(world, true);
        }
        Ok(OpenSensor { sensor, world_with_probe_removed: world })
    }

    fn entry(&self, name: &str) -> Option<&SensorEntry> {
        self.entries.iter().find(|entry| entry.sensor.name == name)
    }

    /// Opens the driver of the sensor; during the replay of a capture, replays its samples without a device.
    async fn open_or_replay_sensor(&self, name: &str) -> Result<SensorHandle, SensorError> {
        let SensorEntry { sensor, connection, .. } =
            self.entry(name).ok_or_else(|| SensorError::UnknownSensor { name: name.to_owned() })?;
        let capture = SensorRequestCapture::from_mode(&self.link_mode, &format!("sensor {name}"));
        if capture.is_replayed() {
            return Ok(SensorHandle::replaying_capture(name, capture));
        }
        let opened = match (connection, &self.world) {
            (SensorConnection::Simulated(simulated), Some(world)) => {
                simulated.start_and_open_driver(sensor, world).await
            }
            (SensorConnection::Real(real), _) => real.open_sensor(sensor, self.clock.clone(), &self.ports).await,
            (SensorConnection::Simulated(_), None) => Err(SensorError::NoSimulatedMachine { name: name.to_owned() }),
        };
        opened?.recording_to(capture).await
    }
}

/// Scale of a rotary encoder's counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EncoderScale {
    /// Axis of the encoder, and its counts per turn with their sign.
    pub encoder: AxisEncoder,
    /// Number of counts after which the count wraps.
    pub wrap_count: u64,
}

/// An open sensor; dropping it closes the sensor and puts a removed simulated probe back.
pub struct OpenSensor {
    sensor: SensorHandle,
    /// World whose probe is removed until this sensor is dropped; `None`: the machine is real, or the sensor is not
    /// in the spindle.
    world_with_probe_removed: Option<Arc<Mutex<SimulatedWorld>>>,
}

impl Deref for OpenSensor {
    type Target = SensorHandle;

    fn deref(&self) -> &SensorHandle {
        &self.sensor
    }
}

impl Drop for OpenSensor {
    fn drop(&mut self) {
        if let Some(world) = &self.world_with_probe_removed {
            set_probe_removed(world, false);
        }
    }
}

fn set_probe_removed(world: &Mutex<SimulatedWorld>, is_removed: bool) {
    world.lock().unwrap_or_else(PoisonError::into_inner).set_probe_removed(is_removed);
}
