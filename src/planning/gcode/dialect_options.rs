//! Options that a machine adds to its dialect: commands that switch probe and clamps, inputs that report the state
//! of the probe. The machine file declares them. The G-code reader refuses a command that is not declared.

use std::collections::BTreeMap;

use minijinja::value::Value;

use super::error::DialectError;
use super::rs274::{DeclaredCommands, LineError, SwitchEffect};
use machine::record::machine::{Clamp, Machine, Probe};
use machine::{Axis, Position};

/// Options that the machine file adds to a dialect; by default none.
#[derive(Debug, Clone, Default)]
pub(super) struct DialectOptions {
    /// Command that switches the probe on, e.g. `M64 P1`. `None`: the program does not switch the probe on.
    pub(super) probe_on_command: Option<String>,
    /// Command that switches the probe off. `None`: the program does not switch the probe off.
    pub(super) probe_off_command: Option<String>,
    /// Clamps of the axes that declare one, with their commands and waiting time.
    pub(super) clamps: BTreeMap<Axis, Clamp>,
    /// Name of the input that is on while the probe reports an error.
    pub(super) probe_error_input: Option<String>,
    /// Name of the input that is on while the battery of the probe is low.
    pub(super) probe_battery_input: Option<String>,
    /// Commands of probe and clamps that the G-code reader accepts, with their effects.
    pub(super) declared_commands: DeclaredCommands,
}

/// Fault that a probe reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProbeFault {
    ErrorReported,
    LowBattery,
}

impl ProbeFault {
    pub fn description(self) -> &'static str {
        match self {
            ProbeFault::ErrorReported => "reports an error",
            ProbeFault::LowBattery => "reports a low battery",
        }
    }

    /// What the operator should do next.
    pub fn remedy(self) -> &'static str {
        match self {
            ProbeFault::ErrorReported => "check that the probe is on, undamaged and in sight of its receiver",
            ProbeFault::LowBattery => "replace the battery, then start again; the readings so far are kept",
        }
    }
}

impl DialectOptions {
    /// # Errors
    /// A command is not exactly one M word, already has another meaning, or has two meanings.
    pub(super) fn new(machine: &Machine, probe: &Probe) -> Result<Self, DialectError> {
        let axes = machine.axes.iter();
        let clamps: BTreeMap<Axis, Clamp> =
            axes.filter_map(|(axis, spec)| Some((*axis, spec.clamp.clone()?))).collect();
        let mut declared = DeclaredCommands::default();
        let mut declare = |key: String, text: &str, switch| {
            let refused = |error: LineError| DialectError::InvalidOption {
                key,
                value: text.to_owned(),
                reason: error.to_string(),
            };
            declared.add_command(text, switch).map_err(refused)
        };
        for (key, text, on) in [("on", &probe.on, true), ("off", &probe.off, false)] {
            if let Some(text) = text {
                declare(format!("[probe] {key}"), text, SwitchEffect::ProbeOn(on))?;
            }
        }
        for (axis, clamp) in &clamps {
            declare(format!("[axes.{axis}] clamp.close"), &clamp.close, SwitchEffect::ClampClosed(*axis, true))?;
            declare(format!("[axes.{axis}] clamp.open"), &clamp.open, SwitchEffect::ClampClosed(*axis, false))?;
        }
        Ok(Self {
            probe_on_command: probe.on.clone(),
            probe_off_command: probe.off.clone(),
            clamps,
            probe_error_input: probe.error_input.clone(),
            probe_battery_input: probe.battery_input.clone(),
            declared_commands: declared,
        })
    }

    /// Names for every template: `probe_on`, `probe_off`, `error_input`, `battery_input` if they are declared;
    /// `clamps` (`open`, `close`, `wait_s`) of the axes that `to` moves, or of all axes without `to`.
    pub(super) fn template_values(&self, to: Option<&Position>) -> Vec<(&'static str, Value)> {
        let texts = [
            ("probe_on", &self.probe_on_command),
            ("probe_off", &self.probe_off_command),
            ("error_input", &self.probe_error_input),
            ("battery_input", &self.probe_battery_input),
        ];
        let named = texts.into_iter().filter_map(|(name, text)| Some((name, text.as_ref()?)));
        let mut names: Vec<_> = named.map(|(name, text)| (name, Value::from(text))).collect();
        let moved = |axis: &Axis| to.is_none_or(|to| to.get(*axis).is_some());
        let clamps = self.clamps.iter().filter(|(axis, _)| moved(axis)).map(|(_, clamp)| {
            Value::from_pairs([
                ("open", Value::from(&clamp.open)),
                ("close", Value::from(&clamp.close)),
                ("wait_s", Value::from(clamp.wait_s)),
            ])
        });
        names.push(("clamps", clamps.collect()));
        names
    }
}
