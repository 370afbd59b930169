//! The simulated machine of a file, and its simulated operator.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use super::machine_file::{Control, MachineFile};
use super::simulated::{Bench, Served, SimulatedControl};
use super::{Devices, Pace, RunHistory, SetupError, modes, world};

use planning::gcode::Dialect;
use simulator::faulty_wire::{BadWire, Planned};
use simulator::{SimulatedOperator, World};

pub struct Rehearsal<'a> {
    file: &'a MachineFile,
    control: SimulatedControl,
    world: Arc<Mutex<World>>,
}

impl<'a> Rehearsal<'a> {
    /// The simulated machine of `file`; a real control is replaced by a simulated one.
    ///
    /// # Errors
    /// The simulated world cannot be built.
    pub fn of(file: &'a MachineFile) -> Result<Self, SetupError> {
        let control = match &file.controller.control {
            Control::Simulated(simulated) => simulated.clone(),
            Control::Real(_) => SimulatedControl::default(),
        };
        Ok(Self { file, control, world: Arc::new(Mutex::new(world(file)?)) })
    }

    /// Advances the world to the time after `past`, with its mountings.
    pub(super) fn after(&self, past: RunHistory<'_>) {
        let mut world = self.world.lock().unwrap_or_else(PoisonError::into_inner);
        past.mounts.iter().for_each(|mount| world.mount(mount.turn_deg));
        if let Some(last) = past.readings.last() {
            let probed = past.readings.iter().map(|reading| reading.step);
            world.pass(last.t_s + past.elapsed_s, probed);
        }
    }

    pub(super) async fn open(&self, dialect: Dialect, pace: Pace) -> Result<Devices, SetupError> {
        let modes = modes(&dialect, &self.file.machine, None)?;
        let (controller, served) = self.control.open(self.bench(pace)?, modes).await?;
        let world = Some(self.world.clone());
        Ok(Devices::new(controller, dialect).of(self.file, world).with_served_control(served))
    }

    /// Serves the simulated control on its wire until dropped. Call inside a tokio runtime.
    ///
    /// # Errors
    /// The wire cannot be opened.
    pub fn serve(&self, pace: Pace) -> Result<Served, SetupError> {
        Ok(self.control.serve(self.bench(pace)?)?)
    }

    /// As [`Self::serve`], with a faulty wire; `tell` is called with each fault and its time.
    ///
    /// # Errors
    /// The wire cannot be opened.
    pub fn serve_badly(
        &self,
        pace: Pace,
        wire: BadWire,
        tell: fn(Duration, Planned),
    ) -> Result<Served, SetupError> {
        Ok(self.control.serve_badly(self.bench(pace)?, wire, tell)?)
    }

    /// Replaces the probe in the spindle by a sensor.
    pub fn without_probe(&self) {
        let mut world = self.world.lock().unwrap_or_else(PoisonError::into_inner);
        world.without_probe(true);
    }

    /// The simulated operator, who observes the true motion.
    pub fn bystander(&self) -> SimulatedOperator {
        SimulatedOperator::new(self.world.clone())
    }

    fn bench(&self, pace: Pace) -> Result<Bench<'a>, SetupError> {
        let faults = self.file.simulated_faults(&self.control)?;
        Ok(Bench { machine: &self.file.machine, world: self.world.clone(), pace, faults })
    }
}
