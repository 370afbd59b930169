//! Options that a machine adds to its dialect: commands that switch probe and clamps, inputs that report the state
//! of the probe. They come from the machine file; the reader refuses an undeclared command like any other that it
//! does not understand.

use std::collections::BTreeMap;

use minijinja::value::Value;

use super::error::DialectError;
use super::rs274::{DeclaredCommands, SwitchEffect};
use machine::record::machine::{Clamp, Machine, Probe};
use machine::{Axis, Position};

/// Options of a machine; the default is the plain dialect.
#[derive(Debug, Clone, Default)]
pub(super) struct DialectOptions {
    pub(super) probe_on: Option<String>,
    pub(super) probe_off: Option<String>,
    pub(super) clamps: BTreeMap<Axis, Clamp>,
    pub(super) error_input: Option<String>,
    pub(super) battery_input: Option<String>,
    pub(super) declared: DeclaredCommands,
}

/// Fault that a probe reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProbeFault {
    Error,
    Battery,
}

impl ProbeFault {
    pub fn description(self) -> &'static str {
        match self {
            Self::Error => "reports an error",
            Self::Battery => "reports a low battery",
        }
    }

    /// What the operator should do next.
    pub fn remedy(self) -> &'static str {
        match self {
            Self::Error => "check that the probe is on, undamaged and in sight of its receiver",
            Self::Battery => "replace the battery, then start again; the readings so far are kept",
        }
    }
}

impl DialectOptions {
    /// # Errors
    /// A command is not exactly one M word, already has another meaning, or has two meanings.
    pub(super) fn new(machine: &Machine, probe: &Probe) -> Result<Self, DialectError> {
        let axes = machine.axes.iter();
        let clamps = axes.filter_map(|(axis, spec)| Some((*axis, spec.clamp.clone()?))).collect();
        let mut options = Self {
            probe_on: probe.on.clone(),
            probe_off: probe.off.clone(),
            clamps,
            error_input: probe.error_input.clone(),
            battery_input: probe.battery_input.clone(),
            declared: DeclaredCommands::default(),
        };
        options.declare_commands()?;
        Ok(options)
    }

    fn declare_commands(&mut self) -> Result<(), DialectError> {
        let mut words: Vec<(String, &str, SwitchEffect)> = Vec::new();
        let probe = [("on", &self.probe_on, true), ("off", &self.probe_off, false)];
        for (key, text, on) in probe {
            let declared = text.iter().map(|t| (format!("[probe] {key}"), t, SwitchEffect::Probe(on)));
            words.extend(declared.map(|(key, text, switch)| (key, text.as_str(), switch)));
        }
        for (axis, clamp) in &self.clamps {
            let key = |end| format!("[axes.{axis}] clamp.{end}");
            words.push((key("close"), &clamp.close, SwitchEffect::Clamp(*axis, true)));
            words.push((key("open"), &clamp.open, SwitchEffect::Clamp(*axis, false)));
        }
        let mut declared = DeclaredCommands::default();
        for (key, text, switch) in words {
            declared.add(text, switch).map_err(|reason| {
                let value = text.to_owned();
                DialectError::InvalidOption { key, value, reason }
            })?;
        }
        self.declared = declared;
        Ok(())
    }

    /// Names for every template: `probe_on`, `probe_off`, `error_input`, `battery_input` if they are declared;
    /// `clamps` (`open`, `close`, `wait_s`) of the axes that `to` moves, or of all axes without `to`.
    pub(super) fn template_values(&self, to: Option<&Position>) -> Vec<(&'static str, Value)> {
        let texts = [
            ("probe_on", &self.probe_on),
            ("probe_off", &self.probe_off),
            ("error_input", &self.error_input),
            ("battery_input", &self.battery_input),
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
