//! Opens the devices of the machine file. All simulated devices share one simulated world.

use std::sync::{Arc, Mutex, PoisonError};

use super::machine_file::MachineFile;
use super::simulated::SimulatedControlServer;
use super::{SensorOpener, SetupError, Thermometers};
use devices::controllers::Controller;
use link::Clock;
use link::clock::HostClock;
use machine::record::machine::Machine;
use machine::record::plan::ArtefactMount;
use machine::record::reading::Reading;
use planning::gcode::Dialect;
use planning::proof::{ProvenModeText, render_and_prove_mode_text};
use simulator::SimulatedWorld;

/// Devices of a machine, as a run needs them: the control is open, the sensors are opened by the run.
pub struct Devices {
    /// Handle of the task that drives the opened control.
    pub open_controller: Controller,
    /// Opens the displacement sensors of the machine.
    pub sensor_opener: SensorOpener,
    /// Thermometers whose temperatures each reading contains.
    pub thermometers: Thermometers,
    /// Dialect of the control; every stage is rendered in it and read back before any motion.
    pub dialect: Dialect,
    /// Clock for readings that the control does not time-stamp.
    pub clock: Arc<dyn Clock>,
    /// The simulated world, if the machine is simulated.
    simulated_world: Option<Arc<Mutex<SimulatedWorld>>>,
    /// The simulated end of the wire, if this program serves it; dropped after the controller.
    _simulated_control_server: Option<SimulatedControlServer>,
}

impl Devices {
    /// Devices with a control that is already open, without sensors and thermometers. The clock of this computer
    /// times the readings that the control does not time-stamp.
    pub fn new(controller: Controller, dialect: Dialect) -> Self {
        Self::with_clock(controller, dialect, Arc::new(HostClock::start()))
    }

    /// Devices with the clock that the control was opened with, without sensors and thermometers.
    pub(super) fn with_clock(controller: Controller, dialect: Dialect, clock: Arc<dyn Clock>) -> Self {
        let sensors = SensorOpener::new(&[], None, clock.clone(), None);
        let thermometers = Thermometers::new(&[], None);
        Self {
            open_controller: controller,
            sensor_opener: sensors,
            thermometers,
            dialect,
            clock,
            simulated_world: None,
            _simulated_control_server: None,
        }
    }

    /// Adds the sensors and thermometers of the machine file; simulated ones measure in `world`.
    pub(super) fn with_sensors(self, file: &MachineFile, world: Option<Arc<Mutex<SimulatedWorld>>>) -> Self {
        let thermometers = Thermometers::new(&file.thermometers, world.clone());
        let sensors = SensorOpener::new(&file.sensors, file.encoder, self.clock.clone(), world.clone());
        Self { sensor_opener: sensors, thermometers, simulated_world: world, ..self }
    }

    /// Mounts a datum cylinder again in the simulated world, as the operator has done; no effect on a real machine.
    pub fn remount_simulated_datum_cylinder(&self, mount: ArtefactMount) {
        if let Some(world) = &self.simulated_world {
            world.lock().unwrap_or_else(PoisonError::into_inner).remount_datum_cylinder(mount.turn_deg);
        }
    }

    /// Adds the server of the simulated control, so that it lives as long as the devices.
    pub(super) fn with_control_server(self, server: Option<SimulatedControlServer>) -> Self {
        Self { _simulated_control_server: server, ..self }
    }
}

/// Readings and mountings of earlier sessions of a run; a simulated machine continues from them.
#[derive(Debug, Clone, Copy, Default)]
pub struct EarlierSessions<'a> {
    /// All readings of the run so far.
    pub readings: &'a [Reading],
    /// Confirmed mountings of the artefact in their order.
    pub mountings: &'a [ArtefactMount],
    /// Time since the last reading, s.
    pub time_since_last_reading_s: f64,
}

/// Renders the program header and footer that set the modes of the control of `machine`, and proves that they contain
/// no motion. `result_log`: file to which the control writes its results, if it has one.
///
/// # Errors
/// The text cannot be rendered or proven.
pub fn prove_mode_text(
    dialect: &Dialect,
    machine: &Machine,
    result_log: Option<String>,
) -> Result<ProvenModeText, SetupError> {
    Ok(render_and_prove_mode_text(dialect, &machine.name, machine.axes.keys().copied(), result_log.as_deref())?)
}

/// Dialect of the machine's control, with the additions of the machine file.
pub fn machine_dialect(file: &MachineFile) -> Result<Dialect, SetupError> {
    let named = Dialect::from_name(file.controller_section.control.dialect())?;
    Ok(named.with_machine_options(&file.machine, &file.probe)?)
}
