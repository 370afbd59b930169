//! Machine-specific commands: the G-code reader accepts only declared commands, and tracks what they switch.

use std::collections::BTreeMap;

use super::LineError;
use super::gcode_line::{GcodeLine, GcodeWords};
use machine::Axis;

/// Effect of a declared command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SwitchEffect {
    /// Probe on (`true`) or off.
    ProbeOn(bool),
    /// Clamp closed (`true`) or open.
    ClampClosed(Axis, bool),
}

/// All declared commands, each a line of its own.
#[derive(Debug, Clone, Default)]
pub struct DeclaredCommands(Vec<(GcodeWords, SwitchEffect)>);

impl DeclaredCommands {
    /// Declares that `text` has the effect of `switch`.
    ///
    /// # Errors
    /// The reason why `text` is refused; as a message that follows `text`.
    pub fn add_command(&mut self, text: &str, switch: SwitchEffect) -> Result<(), LineError> {
        let (words, code) = parse_m_command(text)?;
        if switches_kinematics(code) {
            return Err(format!("M{code} switches the kinematics").into());
        }
        if self.effect_of(&words).is_some() {
            return Err("the command is declared for another function as well".into());
        }
        self.0.push((words, switch));
        Ok(())
    }

    /// Effect of a line that contains exactly `words`. `None`: the line is not a declared command.
    pub(super) fn effect_of(&self, words: &GcodeWords) -> Option<SwitchEffect> {
        self.0.iter().find(|(known, _)| known == words).map(|(_, switch)| *switch)
    }

    fn contains_effect(&self, switch: SwitchEffect) -> bool {
        self.0.iter().any(|(_, known)| *known == switch)
    }
}

/// Checks that `text` is a command that can switch the kinematics: exactly one M word with its parameters, without
/// another known meaning.
///
/// # Errors
/// The reason why `text` is refused; as a message that follows `text`.
pub fn check_kinematics_command(text: &str) -> Result<(), LineError> {
    parse_m_command(text).map(drop)
}

/// Parses a command of the machine file that moves nothing; returns its words and its M word.
fn parse_m_command(text: &str) -> Result<(GcodeWords, u32), LineError> {
    let harmless = |c: char| c.is_ascii_alphanumeric() || " .-".contains(c);
    let refused = || LineError::from("the command must be one M word with its parameters");
    let Some(Ok(GcodeLine::Words(words))) = text.chars().all(harmless).then(|| GcodeLine::parse(text)) else {
        return Err(refused());
    };
    let [code] = words.m_words[..] else { return Err(refused()) };
    if !words.g_words_tenfold.is_empty() || words.letters_except_g_and_m().any(|letter| !"PQE".contains(letter)) {
        return Err(refused());
    }
    if let 62 | 63 = code {
        return Err(format!("M{code} takes effect only with the next move; use M64 or M65").into());
    }
    match fixed_meaning_of_m_word(code) {
        Some(meaning) => Err(format!("M{code} {meaning}").into()),
        None => Ok((words, code)),
    }
}

/// Whether LinuxCNC's samples use the M word to switch the kinematics.
fn switches_kinematics(code: u32) -> bool {
    matches!(code, 128..=130 | 428..=430)
}

/// Meaning of an M word that can switch neither a probe nor a clamp nor the kinematics.
fn fixed_meaning_of_m_word(code: u32) -> Option<&'static str> {
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
        _ => return None,
    })
}

/// State of probe and clamps, as far as the text read so far determines it.
#[derive(Debug, Default)]
pub(super) struct SwitchState {
    declared_commands: DeclaredCommands,
    /// Whether the probe was switched on last. False before the first command.
    is_probe_on: bool,
    /// Whether the clamp of an axis is closed; an axis without an entry: unknown.
    clamp_closed_by_axis: BTreeMap<Axis, bool>,
}

impl SwitchState {
    pub fn new(declared: &DeclaredCommands) -> Self {
        Self { declared_commands: declared.clone(), ..Self::default() }
    }

    /// Whether the line is a declared command; if so, applies it.
    pub fn apply_if_declared(&mut self, words: &GcodeWords) -> bool {
        match self.declared_commands.effect_of(words) {
            Some(SwitchEffect::ProbeOn(on)) => self.is_probe_on = on,
            Some(SwitchEffect::ClampClosed(axis, closed)) => drop(self.clamp_closed_by_axis.insert(axis, closed)),
            None => return false,
        }
        true
    }

    /// Checks that no declared clamp blocks these axes. A clamp whose state is unknown blocks its axis.
    pub fn check_clamps_open(&self, mut axes: impl Iterator<Item = Axis>) -> Result<(), LineError> {
        let clamped = |axis: &Axis| self.has_clamp(*axis) && self.clamp_closed_by_axis.get(axis) != Some(&false);
        match axes.find(clamped) {
            Some(axis) => Err(format!("{axis} moves while its clamp is not open").into()),
            None => Ok(()),
        }
    }

    /// Checks that the probe is on, if a command for this is declared, and that all declared clamps are closed. A
    /// clamp whose state is unknown is refused.
    pub fn check_probe_on_and_clamps_closed(&self) -> Result<(), LineError> {
        if self.declared_commands.contains_effect(SwitchEffect::ProbeOn(true)) && !self.is_probe_on {
            return Err("the probe is not switched on".into());
        }
        let open = |axis: &Axis| self.has_clamp(*axis) && self.clamp_closed_by_axis.get(axis) != Some(&true);
        match Axis::ALL.into_iter().find(open) {
            Some(axis) => Err(format!("a probing move while the clamp of {axis} is not closed").into()),
            None => Ok(()),
        }
    }

    /// Whether a command that opens a clamp of the axis is declared.
    fn has_clamp(&self, axis: Axis) -> bool {
        self.declared_commands.contains_effect(SwitchEffect::ClampClosed(axis, false))
    }
}
