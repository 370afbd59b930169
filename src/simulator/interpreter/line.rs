//! The words of one line, sorted by purpose.

use std::collections::BTreeSet;

use super::words::GrblErrorCode;
use machine::Axis;

/// Modal group 1: G0, G1, G38.2 (`alarms_on_miss`) or G38.3, G80.
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
    /// G10 L2 or L20.
    SetCoordinateSystemOffset,
    /// G53.
    MachineCoordinates,
    SetG92Offset,
    ClearG92Offset,
}

/// The words of one line, sorted by purpose.
#[derive(Debug, Default)]
pub(super) struct LineWords {
    used_modal_groups: BTreeSet<u8>,
    /// Letters of the words so far, except G and M.
    used_letters: BTreeSet<char>,
    /// Values of the axis words as written: mm, inch or degrees.
    pub axis_words: Vec<(Axis, f64)>,
    /// Motion mode that the line states; `None`: the modal one continues.
    pub motion: Option<MotionMode>,
    pub non_modal_code: Option<NonModalCode>,
    /// Whether the line contains M19.
    pub has_spindle_orient: bool,
    /// Whether the line contains M62 to M65.
    pub has_digital_output: bool,
    /// Whether the line contains M2 or M30.
    pub ends_program: bool,
    /// F word of the line as written, in mm, inch or degrees per minute; `None`: the line has none.
    pub feed_word: Option<f64>,
    /// N, L, P and R words that no command has consumed yet; one that remains is an error.
    pub unconsumed_values: Vec<(char, f64)>,
}

impl LineWords {
    /// Removes the unconsumed word `letter` and returns its value; `None`: there is no such word.
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
