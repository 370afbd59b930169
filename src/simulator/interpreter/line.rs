//! The words of one line, sorted by purpose.

use super::words::GrblErrorCode;
use machine::Axis;

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum MotionMode {
    Rapid,
    Feed,
    Probe { alarms_on_miss: bool },
    Off,
}

/// Non-modal G codes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum NonModalCode {
    Dwell,
    SetOffset,
    MachineCoordinates,
    SetG92Offset,
    ClearG92Offset,
}

/// The words of one line, sorted.
#[derive(Debug, Default)]
pub(super) struct LineWords {
    groups: Vec<u8>,
    letters: Vec<char>,
    pub axes: Vec<(Axis, f64)>,
    pub motion: Option<MotionMode>,
    pub non_modal: Option<NonModalCode>,
    pub has_orient: bool,
    pub has_output: bool,
    pub ends_program: bool,
    pub feed: Option<f64>,
    /// Words that a command must consume.
    pub values: Vec<(char, f64)>,
}

impl LineWords {
    /// Removes the word `letter` and returns its value.
    pub(super) fn take_value(&mut self, letter: char) -> Option<f64> {
        let index = self.values.iter().position(|(name, _)| *name == letter)?;
        Some(self.values.remove(index).1)
    }

    /// Rejects a second word with the same letter in a line, except G and M.
    pub(super) fn add_letter(&mut self, letter: char) -> Result<(), GrblErrorCode> {
        if self.letters.contains(&letter) {
            return Err(25);
        }
        self.letters.push(letter);
        Ok(())
    }

    /// Rejects a second word of the same modal group in a line.
    pub(super) fn add_modal_group(&mut self, group: u8) -> Result<(), GrblErrorCode> {
        if self.groups.contains(&group) {
            return Err(21);
        }
        self.groups.push(group);
        Ok(())
    }
}
