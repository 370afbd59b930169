//! Opens what the machine file names and puts it together. One simulated world is shared by
//! everything that is simulated.

use std::sync::{Arc, Mutex, PoisonError};

use super::machine_file::MachineFile;
use super::simulated::Served;
use super::{Sensors, SetupError, Thermometers};
use devices::controllers::Controller;
use link::Clock;
use link::clock::HostClock;
use machine::record::machine::Machine;
use machine::record::plan::ArtefactMount;
use machine::record::reading::Reading;
use planning::gcode::Dialect;
use planning::proof::{ProvenModes, prove_modes};
use simulator::World;

/// The machine as a run needs it.
pub struct Devices {
    pub controller: Controller,
    /// What the machine can look with.
    pub sensors: Sensors,
    /// What each reading carries beside.
    pub thermometers: Thermometers,
    /// The language the control is spoken to; every stage is rendered and read back before it moves.
    pub dialect: Dialect,
    /// Used where the control does not stamp its readings.
    pub clock: Arc<dyn Clock>,
    /// The simulated machine, if it is one.
    world: Option<Arc<Mutex<World>>>,
    /// The other end of the wire, if this program serves it; dropped after the controller.
    _served: Option<Served>,
}

impl Devices {
    /// A control that is open already, timed by the host's clock where it does not stamp.
    pub fn new(controller: Controller, dialect: Dialect) -> Self {
        Self::timed(controller, dialect, Arc::new(HostClock::start()))
    }

    /// With the clock that the control was opened with.
    pub(super) fn timed(controller: Controller, dialect: Dialect, clock: Arc<dyn Clock>) -> Self {
        let sensors = Sensors::none(clock.clone());
        let thermometers = Thermometers::of(&[], None);
        Self { controller, sensors, thermometers, dialect, clock, world: None, _served: None }
    }

    /// With what the machine file names; simulated ones see and feel `world`.
    pub(super) fn of(self, file: &MachineFile, world: Option<Arc<Mutex<World>>>) -> Self {
        let thermometers = Thermometers::of(&file.thermometers, world.clone());
        let sensors = self.sensors.of(&file.sensors, file.encoder);
        let sensors = match world.clone() {
            Some(world) => sensors.looking_at(world),
            None => sensors,
        };
        Self { sensors, thermometers, world, ..self }
    }

    /// A person has mounted the artefact anew: of a simulated machine the one that stands there.
    pub fn artefact_mounted(&self, mount: ArtefactMount) {
        if let Some(world) = &self.world {
            world.lock().unwrap_or_else(PoisonError::into_inner).mount(mount.turn_deg);
        }
    }

    /// With the other end of its wire.
    pub(super) fn behind(self, served: Option<Served>) -> Self {
        Self { _served: served, ..self }
    }
}

/// What a run has seen of its machine in earlier sessions: a simulated one lives on from there.
#[derive(Debug, Clone, Copy, Default)]
pub struct Past<'a> {
    pub readings: &'a [Reading],
    /// How the artefact was mounted, one after the other.
    pub mounts: &'a [ArtefactMount],
    /// Since the last of them.
    pub elapsed_s: f64,
}

/// The text that sets the modes of `machine`'s control.
///
/// # Errors
/// What cannot be written.
pub fn modes(
    dialect: &Dialect,
    machine: &Machine,
    log: Option<String>,
) -> Result<ProvenModes, SetupError> {
    Ok(prove_modes(dialect, &machine.name, machine.axes.keys().copied(), log.as_deref())?)
}

/// The language of the machine's control, with what the machine file adds to it.
pub fn dialect(file: &MachineFile) -> Result<Dialect, SetupError> {
    let named = Dialect::named(file.controller.control.dialect())?;
    Ok(named.with(&file.machine, &file.probe)?)
}
