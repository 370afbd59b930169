//! Construction of a run's parts from a machine file.

mod built_in;
mod controls;
mod devices;
mod draft;
mod error;
pub mod machine_file;
mod rehearsal;
mod sensors;
#[cfg(test)]
mod sensors_tests;
mod simulated;
mod site;
mod thermometers;
mod world;

use std::path::Path;

pub use self::devices::{Devices, RunHistory, dialect, modes};
pub use built_in::{BuiltIn, built_in};
pub use controls::configure;
pub use draft::Draft;
pub use error::SetupError;
pub use machine_file::MachineFile;
pub use rehearsal::Rehearsal;
pub use sensors::{EncoderScale, Mounted, Sensors, sensor};
pub use simulated::Served;
pub use site::{Site, devices};
pub use thermometers::Thermometers;
pub use world::world;

use machine::record::plan::{PLAN_VERSION, Plan};
use methods::Method;
pub use simulator::interpreter::Pace;

/// The machine file at `path`; without a path, the built-in simulated machine for the method.
pub fn load(path: Option<&Path>, method: &str) -> Result<MachineFile, SetupError> {
    check_name(method)?;
    let file = match path {
        Some(path) => MachineFile::read(path)?,
        None => MachineFile::embedded_for(method)?,
    };
    file.check_method_names(&methods::names())?;
    Ok(file)
}

/// The method with its settings and prompts, and the plan without steps. `repeat` overrides the number of
/// repeats.
pub fn header(
    file: &MachineFile,
    name: &str,
    repeat: Option<u32>,
) -> Result<(Box<dyn Method>, Plan), SetupError> {
    check_name(name)?;
    let mut method = file.method(name, |settings| methods::configure(name, settings))?;
    if let Some(repeat) = repeat {
        let mut settings = method.settings();
        let repeats = settings.get_mut("repeats");
        *repeats.ok_or(SetupError::NoRepeats { name: name.to_owned() })? = repeat.into();
        method = methods::configure(name, settings)
            .map_err(|error| SetupError::Settings { why: error.to_string() })?;
    }
    let sensors: Vec<_> = file.sensors.iter().map(|entry| entry.sensor.clone()).collect();
    let required = method.required_sensors(&sensors)?;
    let asked = file.asks_before(name, &required);
    let plan = Plan {
        sensors: required.into_iter().cloned().collect(),
        ..without_steps(file, name, method.settings())
    };
    Ok((methods::with_prompts(method, asked), plan))
}

/// A plan without steps for the machine and its artefact; `what` is the name of the purpose.
pub fn without_steps(file: &MachineFile, what: &str, settings: serde_json::Value) -> Plan {
    Plan {
        trued_plan: PLAN_VERSION,
        method: what.to_owned(),
        settings,
        machine: file.machine.clone(),
        probe: file.probe.clone(),
        sensors: Vec::new(),
        keepout: file.keepout.clone(),
        solids: file.solids.clone(),
        artefact: file.artefact.clone(),
        priors: Vec::new(),
        gaps_s: Vec::new(),
        assumed: file.assumed.clone(),
        compensations_active: file.controller.compensations_active.clone(),
        steps: Vec::new(),
    }
}

fn check_name(method: &str) -> Result<(), SetupError> {
    if methods::description(method).is_some() {
        return Ok(());
    }
    Err(SetupError::NoSuchMethod { name: method.to_owned() })
}
