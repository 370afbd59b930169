//! What a machine adds to its dialect: words of the control's own that switch probe and clamps,
//! inputs that tell of the probe's health. They come from the machine file; a word that is not
//! declared there is refused by the reader like any other that it does not understand.

use std::collections::BTreeMap;

use minijinja::value::Value;

use super::dialect::{Dialect, Inputs};
use super::error::DialectError;
use super::rs274::{Declared, Switch};
use machine::record::machine::{Clamp, Machine, Probe};
use machine::record::motion::Motion;
use machine::{Axis, Position};

/// A probe that was switched on is ready after this time; the heads of controls that are sent line
/// by line wait as long.
const PROBE_WAKES_S: f64 = 1.0;

/// None of it: the plain dialect.
#[derive(Debug, Clone, Default)]
pub(super) struct Options {
    probe_on: Option<String>,
    probe_off: Option<String>,
    clamps: BTreeMap<Axis, Clamp>,
    error_input: Option<String>,
    battery_input: Option<String>,
    pub(super) declared: Declared,
}

impl Dialect {
    /// This dialect with what `machine` and `probe` declare.
    ///
    /// # Errors
    /// A word that is more or less than one M word, that means something else already or two things
    /// at once; an input that this control does not name so.
    pub fn with(mut self, machine: &Machine, probe: &Probe) -> Result<Self, DialectError> {
        let axes = machine.axes.iter();
        let clamps = axes.filter_map(|(axis, spec)| Some((*axis, spec.clamp.clone()?))).collect();
        let mut options = Options {
            probe_on: probe.on.clone(),
            probe_off: probe.off.clone(),
            clamps,
            error_input: probe.error_input.clone(),
            battery_input: probe.battery_input.clone(),
            declared: Declared::default(),
        };
        options.declare()?;
        self.spec.inputs.check("[probe] error_input", options.error_input.as_deref())?;
        self.spec.inputs.check("[probe] battery_input", options.battery_input.as_deref())?;
        self.options = options;
        Ok(self)
    }

    /// The same without the word that switches the probe off: for a control that gets a program a
    /// block, and the last word in a program of its own.
    pub fn keeping_probe_on(&self) -> Self {
        let mut same = self.clone();
        same.options.probe_off = None;
        same
    }

    pub fn switches_probe_on(&self) -> bool {
        self.options.probe_on.is_some()
    }

    pub fn switches_probe_off(&self) -> bool {
        self.options.probe_off.is_some()
    }

    /// How long after the head what it switches is ready, s; `None`: it switches nothing.
    pub fn wakes_s(&self) -> Option<f64> {
        let probe = self.options.probe_on.iter().map(|_| PROBE_WAKES_S);
        let clamps = self.options.clamps.values().map(|clamp| clamp.wait_s);
        probe.chain(clamps).reduce(f64::max)
    }

    /// How long the clamps rest in the lines of `motion`, s.
    pub fn clamps_rest_s(&self, motion: &Motion) -> f64 {
        let Motion::Rapid { to } = motion else { return 0.0 };
        let moved = self.options.clamps.iter().filter(|(axis, _)| to.get(**axis).is_some());
        moved.map(|(_, clamp)| 2.0 * clamp.wait_s).sum()
    }

    /// The inputs that tell of the probe's health, and what each says when it is on.
    pub fn health_inputs(&self) -> impl Iterator<Item = (&str, ProbeFault)> {
        let inputs = [
            (&self.options.error_input, ProbeFault::Error),
            (&self.options.battery_input, ProbeFault::Battery),
        ];
        inputs.into_iter().filter_map(|(input, fault)| Some((input.as_deref()?, fault)))
    }
}

/// What a probe says of itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProbeFault {
    Error,
    Battery,
}

impl ProbeFault {
    pub fn says(self) -> &'static str {
        match self {
            Self::Error => "reports an error",
            Self::Battery => "says that its battery is low",
        }
    }

    /// What to do next.
    pub fn remedy(self) -> &'static str {
        match self {
            Self::Error => "look at the probe and its receiver: is it on, in sight and undamaged?",
            Self::Battery => {
                "put in a fresh battery, then start again; the readings so far are kept"
            }
        }
    }
}

impl Options {
    fn declare(&mut self) -> Result<(), DialectError> {
        let mut words: Vec<(String, &str, Switch)> = Vec::new();
        let probe = [("on", &self.probe_on, true), ("off", &self.probe_off, false)];
        for (key, text, on) in probe {
            let declared = text.iter().map(|t| (format!("[probe] {key}"), t, Switch::Probe(on)));
            words.extend(declared.map(|(key, text, switch)| (key, text.as_str(), switch)));
        }
        for (axis, clamp) in &self.clamps {
            let key = |end| format!("[axes.{axis}] clamp.{end}");
            words.push((key("close"), &clamp.close, Switch::Clamp(*axis, true)));
            words.push((key("open"), &clamp.open, Switch::Clamp(*axis, false)));
        }
        let mut declared = Declared::default();
        for (key, text, switch) in words {
            declared.add(text, switch).map_err(|why| {
                let value = text.to_owned();
                DialectError::Option { key, value, why }
            })?;
        }
        self.declared = declared;
        Ok(())
    }

    /// For every template: `probe_on`, `probe_off`, `error_input`, `battery_input` where they are
    /// declared; `clamps` (`open`, `close`, `wait_s`) of the axes that `to` moves, of all without it.
    pub(super) fn names(&self, to: Option<&Position>) -> Vec<(&'static str, Value)> {
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

impl Inputs {
    fn check(self, key: &str, input: Option<&str>) -> Result<(), DialectError> {
        let Some(input) = input else { return Ok(()) };
        let (holds, why) = match self {
            Self::None => (false, "this control has no inputs that it can look at"),
            Self::Numbers => {
                let number = input.parse::<u8>().is_ok_and(|number| number < 64);
                (number, "this control counts its inputs from 0 to 63")
            }
            Self::Letters => {
                let is_letter = |c: char| c.is_ascii_uppercase() && c != 'P';
                let one = input.len() == 1 && input.chars().all(is_letter);
                (one, "this control names its inputs by one letter, and P is the probe itself")
            }
        };
        let (key, value) = (key.to_owned(), input.to_owned());
        if holds { Ok(()) } else { Err(DialectError::Option { key, value, why: why.to_owned() }) }
    }
}
