//! The machine file: TOML that a person writes and the program never rewrites.
//!
//! An unknown key, a wrong unit, a wrong type, a missing key or an impossible value is an error with file, line
//! and key. Sections of other modules (`[method.NAME]`, `[simulated]`) are kept as text and deserialized into
//! the owner's type on request; their errors have lines as well.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;
use sha2::{Digest, Sha256};

use devices::sensors::thermometer;
use machine::Axis;
use machine::record::artefact::Artefact;
use machine::record::estimate::Limit;
use machine::record::machine::{AxisSpec, Keepout, Machine, Probe, Solid};
use machine::record::sensor::Sensor;

mod artefact;
mod assumed;
mod balls_csv;
#[cfg(test)]
mod balls_tests;
mod check;
mod controller;
mod document;
mod encoder;
mod error;
#[cfg(test)]
mod fuzz;
mod hint;
mod prompt;
mod sensor;
#[cfg(test)]
mod tests;
mod tolerance;
mod value;

use super::built_in::{BuiltIn, built_in};
use super::simulated::{Faults, SimulatedControl};
use artefact::ArtefactSource;
pub use controller::{Control, ControllerConfig};
pub use document::{Document, value_problem};
pub use encoder::Encoder;
pub use error::{MachineFileError, Problem};
use prompt::Prompt;
pub use sensor::{Reached, SensorEntry};
pub use value::{Fault, Value};

const SECTIONS: [&str; 15] = [
    "machine",
    "axes",
    "controller",
    "probe",
    "sensor",
    "encoder",
    "thermometer",
    "keepout",
    "solid",
    "artefact",
    "prompt",
    "method",
    "tolerance",
    "simulated",
    "serve",
];

/// A machine file that was read and checked.
#[derive(Debug, Clone)]
pub struct MachineFile {
    /// The machine with its axes, which the file states in `[axes.X]`.
    pub machine: Machine,
    pub controller: ControllerConfig,
    pub probe: Probe,
    pub sensors: Vec<SensorEntry>,
    /// Encoder whose count the sensors' samples contain.
    pub encoder: Option<Encoder>,
    pub thermometers: Vec<thermometer::Entry>,
    pub keepout: Vec<Keepout>,
    pub solids: Vec<Solid>,
    pub artefact: Artefact,
    prompts: Vec<Prompt>,
    /// Limits for the verdict. Empty: no verdict.
    pub tolerance: Vec<Limit>,
    /// Keys with assumed values, as the file does not state them, e.g. `axes.X.backlash_um`.
    pub assumed: Vec<String>,
    document: Document,
}

impl MachineFile {
    /// The built-in machine file for a method.
    pub fn embedded_for(method: &str) -> Result<Self, MachineFileError> {
        let BuiltIn { file, text } = built_in(method);
        Self::parse(&file, text.to_owned())
    }

    pub fn read(path: &Path) -> Result<Self, MachineFileError> {
        let beside = ArtefactSource::Folder(path.parent().unwrap_or(Path::new("")));
        Self::parsed(Document::read(path)?, beside)
    }

    /// Parses `text` without any other file; `file` is the name in errors.
    pub fn parse(file: &str, text: String) -> Result<Self, MachineFileError> {
        Self::parsed(Document::parse(file, text)?, ArtefactSource::Nothing)
    }

    /// The machine file of a stored run, with the artefact of its plan.
    pub fn stored(file: &str, text: String, artefact: &Artefact) -> Result<Self, MachineFileError> {
        Self::parsed(Document::parse(file, text)?, ArtefactSource::Artefact(artefact))
    }

    fn parsed(document: Document, beside: ArtefactSource<'_>) -> Result<Self, MachineFileError> {
        document.only(&[], &SECTIONS)?;
        let mut machine = machine(&document)?;
        let mut probe = document.required(&["probe"])?;
        check::probe(&document, &probe)?;
        let mut assumed = assumed::fill(&document, &mut machine, &mut probe)?;
        let sensors: Vec<SensorEntry> =
            document.section(&["sensor"], Deserialize::deserialize)?.unwrap_or_default();
        check::alone(&document, "sensor", sensors.iter().map(|entry| &entry.sensor.name))?;
        sensor::check_ports(&document, &sensors)?;
        let encoder = encoder::read(&document, &machine, &sensors)?;
        let thermometers: Vec<thermometer::Entry> =
            document.section(&["thermometer"], Deserialize::deserialize)?.unwrap_or_default();
        check::alone(&document, "thermometer", thermometers.iter().map(|entry| &entry.name))?;
        let keepout: Vec<Keepout> =
            document.section(&["keepout"], Deserialize::deserialize)?.unwrap_or_default();
        check::keepouts(&document, &keepout)?;
        let solids: Vec<Solid> =
            document.section(&["solid"], Deserialize::deserialize)?.unwrap_or_default();
        check::solids(&document, &solids, &machine)?;
        let mut artefact = artefact::read(&document, beside)?;
        check::artefact(&document, &artefact)?;
        assumed::fill_temperatures(&mut artefact, &mut assumed);
        let prompts = prompt::read(&document, &machine)?;
        let controller = controller::read(&document)?;
        let tolerance = tolerance::read(&document)?;
        Ok(Self {
            machine,
            controller,
            probe,
            sensors,
            encoder,
            thermometers,
            keepout,
            solids,
            artefact,
            prompts,
            tolerance,
            assumed,
            document,
        })
    }

    /// Text of the file as it was read.
    pub fn text(&self) -> &str {
        self.document.text()
    }

    /// SHA-256 of [`Self::text`], hexadecimal.
    pub fn sha256(&self) -> String {
        Sha256::digest(self.text()).iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// `[simulated]` as the owner's type; `None` if the file has no such section.
    pub fn simulated<'t, T: Deserialize<'t>>(&'t self) -> Result<Option<T>, MachineFileError> {
        self.document.section(&["simulated"], T::deserialize)
    }

    /// `[serve]` as the owner's type.
    ///
    /// # Errors
    /// The section is missing or invalid.
    pub fn serve<'t, T: Deserialize<'t>>(&'t self) -> Result<T, MachineFileError> {
        self.document.required(&["serve"])
    }

    /// `[[simulated.fault]]` in the keys of the simulated control; no faults if the file has none.
    pub fn simulated_faults(&self, control: &SimulatedControl) -> Result<Faults, MachineFileError> {
        let faults = self.document.section(&["simulated", "fault"], |list| control.faults(list))?;
        Ok(faults.unwrap_or_else(|| control.no_faults()))
    }

    /// `[method.NAME]`, passed to the method's own reader as a serde deserializer; an empty table if the file
    /// has no such section.
    pub fn method<R>(
        &self,
        name: &str,
        read: impl Fn(Value<'_>) -> Result<R, Fault>,
    ) -> Result<R, MachineFileError> {
        match self.document.section(&["method", name], &read)? {
            Some(settings) => Ok(settings),
            None => self.document.empty(&["method", name], &read),
        }
    }

    /// Prompts to the operator before `method` measures with `sensors`.
    pub fn asks_before(&self, method: &str, sensors: &[&Sensor]) -> Vec<String> {
        let asked = self.prompts.iter().filter(|prompt| prompt.is_for(method));
        let of_sensors = match self.controller.control {
            Control::Real(_) => prompt::of_sensors(sensors),
            // A simulated machine has no operator.
            Control::Simulated(_) => None,
        };
        asked.map(|prompt| prompt.text.clone()).chain(of_sensors).collect()
    }

    /// The same machine without prompts.
    pub fn without_prompts(&self) -> Self {
        Self { prompts: Vec::new(), ..self.clone() }
    }

    /// Refuses a `[method.NAME]` or a prompt for an unknown method.
    pub fn check_method_names(&self, known: &[&str]) -> Result<(), MachineFileError> {
        self.document.only(&["method"], known)?;
        prompt::check_methods(&self.document, &self.prompts, known)
    }
}

fn machine(document: &Document) -> Result<Machine, MachineFileError> {
    if document.names(&["machine"])?.iter().any(|key| key == "axes") {
        let problem = Problem::UnknownSection {
            section: "machine.axes".to_owned(),
            known: vec!["axes".to_owned()],
        };
        return Err(document.error_at(&["machine", "axes"], problem));
    }
    let axes: BTreeMap<Axis, AxisSpec> = document.required(&["axes"])?;
    let machine = Machine { axes, ..document.required(&["machine"])? };
    check::machine(document, &machine)?;
    Ok(machine)
}
