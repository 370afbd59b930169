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
use machine::record::estimate::ParameterTolerance;
use machine::record::machine::{Keepout, Machine, Probe, Solid, StatedAxis};
use machine::record::report_data::ReportData;
use machine::record::sensor::Sensor;

mod artefact;
mod assumed_values;
mod balls_csv;
#[cfg(test)]
mod balls_tests;
mod compensation;
mod controller;
mod document;
mod encoder;
mod error;
#[cfg(test)]
mod fuzz;
mod key_hint;
mod located_value;
mod prompt;
mod report_data;
mod semantic_checks;
mod sensor;
#[cfg(test)]
mod tests;
mod tolerance;

use super::simulated::{SimulatedControlConfig, SimulatedFaults};
use artefact::ArtefactSource;
pub use compensation::{CompensationConfig, LinuxcncHalConfig, WorkOffsetConfig};
pub use controller::{ControlConfig, ControllerTable};
pub use document::TomlDocument;
pub use encoder::AxisEncoder;
pub use error::{MachineFileError, MachineFileProblem};
pub use located_value::{LocatedValue, ValueFault};
use prompt::MachineFilePrompt;
pub use sensor::{SensorConnection, SensorEntry};

/// Permitted top-level sections.
const KNOWN_SECTIONS: [&str; 17] = [
    "machine",
    "axes",
    "controller",
    "compensation",
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
    "report",
    "simulated",
    "serve",
];

/// A machine file that was read and checked.
#[derive(Debug, Clone)]
pub struct MachineFile {
    /// The machine with its axes, which the file states in `[axes.X]`; assumed values are filled in.
    pub machine: Machine,
    /// Configuration of the control, from `[controller]`.
    pub controller_section: ControllerTable,
    /// Compensation values of the control, one entry for each `[compensation.KIND]`.
    pub compensation: Vec<CompensationConfig>,
    /// Touch probe of `[probe]`; assumed values are filled in.
    pub probe: Probe,
    /// Displacement sensors, in the order of the file.
    pub sensors: Vec<SensorEntry>,
    /// Encoder whose count the sensors' samples contain; `None`: no sensor transmits a count.
    pub encoder: Option<AxisEncoder>,
    pub thermometers: Vec<thermometer::ThermometerConfig>,
    /// Boxes that nothing may enter, machine frame.
    pub keepout_boxes: Vec<Keepout>,
    /// Bodies of the machine that nothing may collide with.
    pub solids: Vec<Solid>,
    /// Artefact, transformed into the table frame.
    pub artefact: Artefact,
    /// Prompts of `[[prompt]]`, then one for the zero of each axis without a homing switch.
    prompts: Vec<MachineFilePrompt>,
    /// Tolerances for the verdict. Empty: no verdict.
    pub tolerances: Vec<ParameterTolerance>,
    /// Keys with assumed values, as the file does not state them, e.g. `axes.X.backlash_um` or
    /// `artefact.u_temperature_k`.
    pub assumed_keys: Vec<String>,
    /// Data for the report, which no computation uses.
    pub report_data: ReportData,
    document: TomlDocument,
}

impl MachineFile {
    pub fn read(path: &Path) -> Result<Self, MachineFileError> {
        let source = ArtefactSource::FolderOfMachineFile(path.parent().unwrap_or(Path::new("")));
        Self::from_document(TomlDocument::read(path)?, source)
    }

    /// Parses `text` without any other file; `file` is the name in errors.
    pub fn parse(file: &str, text: String) -> Result<Self, MachineFileError> {
        Self::from_document(TomlDocument::parse(file, text)?, ArtefactSource::TextOnly)
    }

    /// The machine file of a stored run, with the artefact of its plan.
    pub fn from_stored_run(file: &str, text: String, artefact: &Artefact) -> Result<Self, MachineFileError> {
        Self::from_document(TomlDocument::parse(file, text)?, ArtefactSource::RecordedArtefact(artefact))
    }

    fn from_document(document: TomlDocument, source: ArtefactSource<'_>) -> Result<Self, MachineFileError> {
        document.check_keys_are_known(&[], &KNOWN_SECTIONS)?;
        let mut machine = read_machine(&document)?;
        let mut probe = document.deserialize_required_section(&["probe"])?;
        semantic_checks::check_probe(&document, &probe)?;
        let mut assumed = assumed_values::fill_assumed_values(&document, &mut machine, &mut probe)?;
        let sensors: Vec<SensorEntry> = document.read_list("sensor")?;
        semantic_checks::check_unique_names(&document, "sensor", sensors.iter().map(|entry| &entry.sensor.name))?;
        sensor::check_shared_port_settings(&document, &sensors)?;
        let encoder = encoder::read_encoder(&document, &machine, &sensors)?;
        let thermometers: Vec<thermometer::ThermometerConfig> = document.read_list("thermometer")?;
        semantic_checks::check_unique_names(&document, "thermometer", thermometers.iter().map(|entry| &entry.name))?;
        let keepout: Vec<Keepout> = document.read_list("keepout")?;
        semantic_checks::check_keepouts(&document, &keepout)?;
        let solids: Vec<Solid> = document.read_list("solid")?;
        semantic_checks::check_solids(&document, &solids, &machine)?;
        let mut artefact = artefact::read_artefact(&document, source)?;
        semantic_checks::check_artefact(&document, &artefact)?;
        assumed_values::fill_assumed_thermal_values(&mut artefact, &mut assumed);
        let prompts = prompt::read_prompts(&document, &machine)?;
        let controller = controller::read_controller(&document)?;
        Ok(Self {
            machine,
            tolerances: tolerance::read_tolerances(&document)?,
            compensation: compensation::read_compensation(&document, controller.control.dialect())?,
            controller_section: controller,
            probe,
            sensors,
            encoder,
            thermometers,
            keepout_boxes: keepout,
            solids,
            artefact,
            prompts,
            assumed_keys: assumed,
            report_data: report_data::read_report_data(&document)?,
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

    /// The section `[simulated]` as the type of the module that uses it; `None` if the file has no such section.
    pub fn read_simulated_section<'t, T: Deserialize<'t>>(&'t self) -> Result<Option<T>, MachineFileError> {
        self.document.read_section(&["simulated"], T::deserialize)
    }

    /// The section `[serve]` as the type of the module that uses it.
    ///
    /// # Errors
    /// The section is missing or invalid.
    pub fn read_serve_section<'t, T: Deserialize<'t>>(&'t self) -> Result<T, MachineFileError> {
        self.document.deserialize_required_section(&["serve"])
    }

    /// Faults of the simulated control, from `[[simulated.fault]]`; empty if the file states none.
    pub fn simulated_faults(&self, control: &SimulatedControlConfig) -> Result<SimulatedFaults, MachineFileError> {
        let faults = self.document.read_section(&["simulated", "fault"], |list| control.read_faults(list))?;
        Ok(faults.unwrap_or_default())
    }

    /// `[method.NAME]`, passed to the method's own reader as a serde deserializer; an empty table if the file
    /// has no such section.
    pub fn read_method_section<R>(
        &self,
        name: &str,
        read: impl Fn(LocatedValue<'_>) -> Result<R, ValueFault>,
    ) -> Result<R, MachineFileError> {
        match self.document.read_section(&["method", name], &read)? {
            Some(settings) => Ok(settings),
            None => self.document.read_from_empty_table(&["method", name], &read),
        }
    }

    /// Prompts to the operator before `method` measures with `sensors`: those of the file for this method, those for
    /// the zeros of axes without a homing switch and, on a real machine with sensors, one for their mounting.
    pub fn prompts_for_method(&self, method: &str, sensors: &[&Sensor]) -> Vec<String> {
        let asked = self.prompts.iter().filter(|prompt| prompt.applies_to(method));
        let sensor_prompt = match self.controller_section.control {
            ControlConfig::Real(_) => prompt::sensor_prompt(sensors),
            // No sensor prompt: a simulated machine has no operator.
            ControlConfig::Simulated(_) => None,
        };
        asked.map(|prompt| prompt.text.clone()).chain(sensor_prompt).collect()
    }

    /// The same machine without the prompts of the file and without those for the zeros of axes. The prompt for the
    /// mounting of sensors stays.
    pub fn without_prompts(&self) -> Self {
        Self { prompts: Vec::new(), ..self.clone() }
    }

    /// Refuses a `[method.NAME]` or a prompt for an unknown method.
    pub fn check_method_names(&self, known: &[&str]) -> Result<(), MachineFileError> {
        self.document.check_keys_are_known(&["method"], known)?;
        prompt::check_prompt_methods(&self.document, &self.prompts, known)
    }
}

/// Machine of `[machine]` with the axes of `[axes.X]`, checked; missing keys are not filled in yet.
fn read_machine(document: &TomlDocument) -> Result<Machine, MachineFileError> {
    if document.key_names(&["machine"])?.iter().any(|key| key == "axes") {
        let problem =
            MachineFileProblem::UnknownSection { section: "machine.axes".to_owned(), known: vec!["axes".to_owned()] };
        return Err(document.error_at_key(&["machine", "axes"], problem));
    }
    let axes: BTreeMap<Axis, StatedAxis> = document.deserialize_required_section(&["axes"])?;
    let machine = Machine { axes, ..document.deserialize_required_section(&["machine"])? };
    semantic_checks::check_machine(document, &machine)?;
    Ok(machine)
}
