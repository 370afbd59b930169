//! Construction of a run's parts from a machine file.

mod built_in;
mod controls;
mod devices;
mod draft;
mod error;
pub mod machine_file;
mod reopenable_machine;
mod sensors;
#[cfg(test)]
mod sensors_tests;
mod simulated;
mod simulated_machine;
mod thermometers;
mod world;

use std::path::Path;

pub use self::devices::{Devices, EarlierSessions, machine_dialect, prove_mode_text};
pub use controls::{configure_control, control_hints, control_kinds};
pub use draft::MachineFileDraft;
pub use error::SetupError;
pub use machine_file::{
    CompensationConfig, ControlConfig, LinuxcncHalConfig, MachineFile, MachineFileError, WorkOffsetConfig,
};
pub use reopenable_machine::{ReopenableMachine, open_devices};
pub use sensors::{EncoderScale, OpenSensor, SensorOpener, open_sensor};
pub use simulated::SimulatedControlServer;
pub use simulated_machine::SimulatedMachine;
pub use thermometers::Thermometers;
pub use world::build_world;

use machine::record::plan::{PLAN_VERSION, Plan};
use methods::Method;
pub use simulator::interpreter::SimulationPace;

/// The machine file at `path`; without a path, the built-in simulated machine for the method.
///
/// # Errors
/// `method` is unknown, or the file is invalid, or it has settings or a prompt for an unknown method.
pub fn load_machine_file(path: Option<&Path>, method: &str) -> Result<MachineFile, SetupError> {
    check_method_name(method)?;
    let file = match path {
        Some(path) => MachineFile::read(path)?,
        None => MachineFile::built_in_for_method(method)?,
    };
    file.check_method_names(&methods::method_names())?;
    Ok(file)
}

/// The method with its settings and prompts, and the plan without steps, with only the sensors that the method
/// requires. `repeat_count` overrides the number of repeats of the file (an error if the method has none); `None`: as
/// the file states it.
pub fn configure_method_and_plan_without_steps(
    file: &MachineFile,
    name: &str,
    repeat_count: Option<u32>,
) -> Result<(Box<dyn Method>, Plan), SetupError> {
    check_method_name(name)?;
    let mut method = file.read_method_section(name, |settings| methods::configure_method(name, settings))?;
    if let Some(repeat_count) = repeat_count {
        if !methods::method_description(name).is_some_and(|description| description.has_cycle_passes) {
            return Err(SetupError::RepeatsNotSupported { name: name.to_owned() });
        }
        let mut settings = method.settings();
        settings["repeats"] = repeat_count.into();
        method = methods::configure_method(name, settings)
            .map_err(|error| SetupError::MethodSettings { why: error.to_string() })?;
    }
    let sensors: Vec<_> = file.sensors.iter().map(|entry| entry.sensor.clone()).collect();
    let required = method.required_sensors(&sensors)?;
    let prompts = file.prompts_for_method(name, &required);
    let plan =
        Plan { sensors: required.into_iter().cloned().collect(), ..plan_without_steps(file, name, method.settings()) };
    Ok((methods::with_prompts(method, prompts), plan))
}

/// A plan without steps for the machine and its artefact. `purpose`: name of the method, or `check` for a jog.
pub fn plan_without_steps(file: &MachineFile, purpose: &str, settings: serde_json::Value) -> Plan {
    Plan {
        trued_plan: PLAN_VERSION,
        method: purpose.to_owned(),
        settings,
        machine: file.machine.clone(),
        probe: file.probe.clone(),
        sensors: Vec::new(),
        keepout: file.keepout_boxes.clone(),
        solids: file.solids.clone(),
        artefact: file.artefact.clone(),
        priors: Vec::new(),
        interruption_times_s: Vec::new(),
        assumed: file.assumed_keys.clone(),
        compensations_active: file.controller_section.compensations_active.clone(),
        report: file.report_data.clone(),
        steps: Vec::new(),
    }
}

fn check_method_name(method: &str) -> Result<(), SetupError> {
    if methods::method_description(method).is_some() {
        return Ok(());
    }
    Err(SetupError::NoSuchMethod { name: method.to_owned() })
}
