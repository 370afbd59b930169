//! Machine-specific commands: the reader accepts only declared commands, and tracks what they switch.

use std::collections::BTreeMap;

use super::line::{Line, Words};
use machine::Axis;

/// Effect of a declared command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Switch {
    /// Probe on (`true`) or off.
    Probe(bool),
    /// Clamp closed (`true`) or open.
    Clamp(Axis, bool),
}

/// All declared commands, each a line of its own.
#[derive(Debug, Clone, Default)]
pub struct Declared(Vec<(Words, Switch)>);

impl Declared {
    /// Declares that `text` has the effect of `switch`.
    ///
    /// # Errors
    /// The reason why `text` is refused; as a message that follows `text`.
    pub fn add(&mut self, text: &str, switch: Switch) -> Result<(), String> {
        let harmless = |c: char| c.is_ascii_alphanumeric() || " .-".contains(c);
        let refused = || "it must be one M word with its parameters".to_owned();
        let Some(Ok(Line::Words(words))) = text.chars().all(harmless).then(|| Line::parse(text))
        else {
            return Err(refused());
        };
        let [code] = words.m.as_slice() else { return Err(refused()) };
        if !words.g.is_empty() || words.letters().any(|letter| !"PQE".contains(letter)) {
            return Err(refused());
        }
        match code {
            62 | 63 => return Err(format!("M{code} waits for the next move; M64 and M65 do not")),
            _ => {}
        }
        if let Some(meaning) = meaning(*code) {
            return Err(format!("M{code} {meaning}"));
        }
        if self.of(&words).is_some() {
            return Err("it is declared for something else as well".to_owned());
        }
        self.0.push((words, switch));
        Ok(())
    }

    /// Effect of a line that contains exactly these words.
    pub(super) fn of(&self, words: &Words) -> Option<Switch> {
        self.0.iter().find(|(known, _)| known == words).map(|(_, switch)| *switch)
    }

    fn declares(&self, switch: Switch) -> bool {
        self.0.iter().any(|(_, known)| *known == switch)
    }
}

/// Meaning of an M word that can never switch a probe or clamp.
fn meaning(code: u32) -> Option<&'static str> {
    Some(match code {
        0 | 1 | 60 => "pauses the program",
        2 | 30 => "ends the program",
        3..=5 | 19 => "turns or stops the spindle",
        6 | 61 => "changes the tool",
        7..=9 => "switches the coolant",
        47 | 98 | 99 => "calls or repeats a program",
        48..=53 => "switches overrides and feed hold",
        66 => "reads an input",
        70..=73 => "saves or restores modal state",
        128..=130 | 428..=430 => "switches the kinematics",
        _ => return None,
    })
}

/// State of the switches, as far as the text shows it.
#[derive(Debug, Default)]
pub(super) struct Switches {
    declared: Declared,
    probe_on: bool,
    /// `true`: closed. Absent: unknown.
    clamps: BTreeMap<Axis, bool>,
}

impl Switches {
    pub fn new(declared: &Declared) -> Self {
        Self { declared: declared.clone(), ..Self::default() }
    }

    /// Whether the line is a declared command; if so, applies it.
    pub fn obey(&mut self, words: &Words) -> bool {
        match self.declared.of(words) {
            Some(Switch::Probe(on)) => self.probe_on = on,
            Some(Switch::Clamp(axis, closed)) => drop(self.clamps.insert(axis, closed)),
            None => return false,
        }
        true
    }

    /// Checks that no clamp blocks these axes.
    pub fn may_move(&self, mut axes: impl Iterator<Item = Axis>) -> Result<(), String> {
        let clamped = |axis: &Axis| self.has_clamp(*axis) && self.clamps.get(axis) != Some(&false);
        match axes.find(clamped) {
            Some(axis) => Err(format!("{axis} moves, and its clamp is not open")),
            None => Ok(()),
        }
    }

    /// Checks that the probe is on and all clamps are closed.
    pub fn may_probe(&self) -> Result<(), String> {
        if self.declared.declares(Switch::Probe(true)) && !self.probe_on {
            return Err("the probe is not switched on".to_owned());
        }
        let open = |axis: &Axis| self.has_clamp(*axis) && self.clamps.get(axis) != Some(&true);
        match Axis::ALL.into_iter().find(open) {
            Some(axis) => Err(format!("a probing move, and the clamp of {axis} is not closed")),
            None => Ok(()),
        }
    }

    fn has_clamp(&self, axis: Axis) -> bool {
        self.declared.declares(Switch::Clamp(axis, false))
    }
}
