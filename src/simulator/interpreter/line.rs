//! The words of one line, sorted by purpose.

use std::collections::BTreeSet;

use super::words::GrblErrorCode;
use machine::Axis;

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum MotionMode {
    Rapid,
    Feed,
    Probe { alarms_on_miss: bool },
    Cancelled,
}

/// Non-modal G codes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum NonModalCode {
    Dwell,
    SetCoordinateSystemOffset,
    MachineCoordinates,
    SetG92Offset,
    ClearG92Offset,
}

/// The words of one line, sorted by purpose.
#[derive(Debug, Default)]
pub(super) struct LineWords {
    used_modal_groups: BTreeSet<u8>,
    used_letters: BTreeSet<char>,
    pub axis_words: Vec<(Axis, f64)>,
    pub motion: Option<MotionMode>,
    pub non_modal_code: Option<NonModalCode>,
    pub has_spindle_orient: bool,
    pub has_digital_output: bool,
    pub ends_program: bool,
    /// F word of the line; `None`: it has none.
    pub feed_word: Option<f64>,
    /// Words that a command must consume.
    pub unconsumed_values: Vec<(char, f64)>,
}

impl LineWords {
    /// Removes the word `letter` and returns its value.
    pub(super) fn take_value(&mut self, letter: char) -> Option<f64> {
        let index = self.unconsumed_values.iter().position(|(name, _)| *name == letter)?;
        Some(self.unconsumed_values.remove(index).1)
    }

    /// Rejects a second word with the same letter in a line, except G and M.
    pub(super) fn add_unique_letter(&mut self, letter: char) -> Result<(), GrblErrorCode> {
        if self.used_letters.insert(letter) { Ok(()) } else { Err(25) }
    }

    /// Rejects a second word of the same modal group in a line.
    pub(super) fn add_unique_modal_group(&mut self, group: u8) -> Result<(), GrblErrorCode> {
        if self.used_modal_groups.insert(group) { Ok(()) } else { Err(21) }
    }
}
