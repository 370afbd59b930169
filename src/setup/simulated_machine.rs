//! The simulated machine of a file, and its simulated operator.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use super::machine_file::{ControlConfig, MachineFile};
use super::simulated::{SimulatedControlConfig, SimulatedControlServer, SimulationSetup};
use super::{Devices, EarlierSessions, SetupError, SimulationPace, build_world, prove_mode_text};

use planning::gcode::Dialect;
use simulator::faulty_wire::{FaultyWire, PlannedFault};
use simulator::{SimulatedOperator, SimulatedWorld};

/// The world of a machine file and its simulated control, which runs only while it is opened or served.
pub struct SimulatedMachine<'a> {
    file: &'a MachineFile,
    /// Configuration of the simulated control: that of the file, or the default if the file has a real control.
    control: SimulatedControlConfig,
    world: Arc<Mutex<SimulatedWorld>>,
}

impl<'a> SimulatedMachine<'a> {
    /// The simulated machine of `file`; a real control is replaced by the default simulated one, grblHAL.
    ///
    /// # Errors
    /// The simulated world cannot be built.
    pub fn new(file: &'a MachineFile) -> Result<Self, SetupError> {
        let control = match &file.controller_section.control {
            ControlConfig::Simulated(simulated) => simulated.clone(),
            ControlConfig::Real(_) => SimulatedControlConfig::default(),
        };
        Ok(Self { file, control, world: Arc::new(Mutex::new(build_world(file)?)) })
    }

    /// Advances the world to the time after `history`, with its mountings; without a reading, no time passes. The
    /// axes keep their positions.
    pub(super) fn advance_past_sessions(&self, history: EarlierSessions<'_>) {
        let mut world = self.world.lock().unwrap_or_else(PoisonError::into_inner);
        history.mountings.iter().for_each(|mount| world.remount_datum_cylinder(mount.turn_deg));
        if let Some(last) = history.readings.last() {
            let probed = history.readings.iter().map(|reading| reading.step);
            world.advance(last.t_s + history.time_since_last_reading_s, probed);
        }
    }

    /// Starts the control and opens its driver; the axes keep the positions that they have in the world.
    pub(super) async fn open(&self, dialect: Dialect, pace: SimulationPace) -> Result<Devices, SetupError> {
        let modes = prove_mode_text(&dialect, &self.file.machine, None)?;
        let (controller, served) = self.control.start_and_open_driver(self.simulation_setup(pace)?, modes).await?;
        let world = Some(self.world.clone());
        Ok(Devices::new(controller, dialect).with_sensors(self.file, world).with_control_server(served))
    }

    /// Serves the simulated control until the returned server is dropped; grblHAL always on a new pseudo-terminal.
    /// Call inside a tokio runtime.
    ///
    /// # Errors
    /// The wire cannot be opened, or `[[simulated.fault]]` is invalid.
    pub fn serve_control(&self, pace: SimulationPace) -> Result<SimulatedControlServer, SetupError> {
        Ok(self.control.serve(self.simulation_setup(pace)?)?)
    }

    /// As [`Self::serve_control`], with a faulty wire; grblHAL only. `on_fault` is called with each fault and the
    /// time since the wire was connected.
    ///
    /// # Errors
    /// The errors of [`Self::serve_control`], or the control is not grblHAL.
    pub fn serve_control_with_faulty_wire(
        &self,
        pace: SimulationPace,
        wire: FaultyWire,
        on_fault: fn(Duration, PlannedFault),
    ) -> Result<SimulatedControlServer, SetupError> {
        Ok(self.control.serve_with_faulty_wire(self.simulation_setup(pace)?, wire, on_fault)?)
    }

    /// Removes the probe from the spindle, as if a sensor replaced it.
    pub fn remove_probe(&self) {
        self.world.lock().unwrap_or_else(PoisonError::into_inner).set_probe_removed(true);
    }

    /// The simulated operator, who observes the true motion.
    pub fn simulated_operator(&self) -> SimulatedOperator {
        SimulatedOperator::new(self.world.clone())
    }

    fn simulation_setup(&self, pace: SimulationPace) -> Result<SimulationSetup<'a>, SetupError> {
        let faults = self.file.simulated_faults(&self.control)?;
        Ok(SimulationSetup { machine: &self.file.machine, world: self.world.clone(), pace, faults })
    }
}
