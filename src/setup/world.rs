//! Simulated world of a machine file.

use super::{MachineFile, SetupError};
use simulator::{MachineTruth, SimulatedWorld};

/// The world built from the simulated truth of a machine file; without `[simulated]`, from the default truth.
pub fn build_world(file: &MachineFile) -> Result<SimulatedWorld, SetupError> {
    let truth: MachineTruth = file.read_simulated_section()?.unwrap_or_default();
    let sensors: Vec<_> = file.sensors.iter().map(|entry| entry.sensor.clone()).collect();
    let thermometers: Vec<_> = file.thermometers.iter().map(|entry| entry.name.as_str()).collect();
    let world = SimulatedWorld::new(&file.machine, &file.probe, &file.artefact, &truth)?;
    Ok(world.with_sensors(&sensors)?.with_thermometers(&thermometers)?)
}
