//! `[[prompt]]`: prompts to the operator before a method measures.

use machine::Axis;
use machine::record::machine::{Homing, Machine};
use machine::record::sensor::{Sensor, SensorMount};
use serde::Deserialize;

use super::document::TomlDocument;
use super::error::MachineFileError;

/// Maximum length of a prompt, characters: operators do not read longer texts.
const MAX_PROMPT_CHARS: usize = 200;

/// A prompt as `[[prompt]]` states it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MachineFilePrompt {
    pub text: String,
    /// Names of methods; `None`: all methods.
    pub methods: Option<Vec<String>>,
}

impl MachineFilePrompt {
    pub fn applies_to(&self, method: &str) -> bool {
        self.methods.as_ref().is_none_or(|methods| methods.iter().any(|name| name == method))
    }
}

/// Prompts of the machine file, then one for the zero of each axis without a homing switch.
pub fn read_prompts(document: &TomlDocument, machine: &Machine) -> Result<Vec<MachineFilePrompt>, MachineFileError> {
    let prompts: Vec<MachineFilePrompt> = document.read_list("prompt")?;
    for (index, MachineFilePrompt { text, .. }) in prompts.iter().enumerate() {
        let why = match text.chars().count() {
            _ if text.trim().is_empty() => "must not be empty: write the instruction for the operator".to_owned(),
            _ if text.chars().any(char::is_control) => "must be a single line".to_owned(),
            long if long > MAX_PROMPT_CHARS => {
                format!("has {long} characters; the maximum is {MAX_PROMPT_CHARS}")
            }
            _ => continue,
        };
        return Err(document.entry_value_error(&["prompt"], index, "text", why));
    }
    let unhomed = machine.axes.iter().filter(|(_, spec)| spec.homing == Homing::None);
    Ok(prompts.into_iter().chain(unhomed.map(|(axis, _)| zero_mark_prompt(*axis))).collect())
}

/// Prompt, for all methods, to check the zero of an axis without a homing switch.
fn zero_mark_prompt(axis: Axis) -> MachineFilePrompt {
    let text = format!(
        "{axis} has no homing switch. Is {axis} at its zero mark when the control shows {axis} 0 in machine \
        coordinates? If not, first correct the zero of {axis} at the control."
    );
    MachineFilePrompt { text, methods: None }
}

/// Prompt before a method with displacement sensors; `None` without sensors. The sensors replace the probe: a contact
/// does not stop the machine, and the control does not report the position of a sensor.
pub fn sensor_prompt(sensors: &[&Sensor]) -> Option<String> {
    let places = [
        (SensorMount::Spindle, "in the spindle"),
        (SensorMount::Table, "on the table"),
        (SensorMount::Bed, "on the bed"),
    ];
    let on = |(mount, place): (SensorMount, &str)| {
        let there = sensors.iter().filter(|sensor| sensor.mount == mount);
        let names: Vec<String> = there.map(|sensor| format!("`{}`", sensor.name)).collect();
        (!names.is_empty()).then(|| format!("{} {place}", names.join(", ")))
    };
    let mounted: Vec<String> = places.into_iter().filter_map(on).collect();
    (!mounted.is_empty()).then(|| {
        format!(
            "Mounted without covers: {}. Place the artefact at its position in the machine file and clear the path. \
            A contact does not stop the machine: keep the emergency stop within reach until the first scan is read.",
            mounted.join("; ")
        )
    })
}

/// Checks that prompts name known methods only.
pub fn check_prompt_methods(
    document: &TomlDocument,
    prompts: &[MachineFilePrompt],
    known: &[&str],
) -> Result<(), MachineFileError> {
    for (index, prompt) in prompts.iter().enumerate() {
        let names = prompt.methods.iter().flatten();
        if let Some(name) = names.into_iter().find(|name| !known.contains(&name.as_str())) {
            let why = format!("contains the unknown method `{name}`; known are {}", known.join(", "));
            return Err(document.entry_value_error(&["prompt"], index, "methods", why));
        }
    }
    Ok(())
}
