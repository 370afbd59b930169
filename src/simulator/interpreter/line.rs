//! The words of one line, sorted by purpose.

use super::words::Code;
use machine::Axis;

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Motion {
    Rapid,
    Feed,
    Probe { strict: bool },
    Off,
}

/// Non-modal G codes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Once {
    Dwell,
    SetOffset,
    MachineCoordinates,
    Shift,
    ShiftOff,
}

/// The words of one line, sorted.
#[derive(Debug, Default)]
pub(super) struct Line {
    groups: Vec<u8>,
    letters: Vec<char>,
    pub axes: Vec<(Axis, f64)>,
    pub motion: Option<Motion>,
    pub once: Option<Once>,
    pub orient: bool,
    pub output: bool,
    pub ends: bool,
    pub feed: Option<f64>,
    /// Words that a command must consume.
    pub values: Vec<(char, f64)>,
}

impl Line {
    /// Removes the word `letter` and returns its value.
    pub(super) fn value(&mut self, letter: char) -> Option<f64> {
        let place = self.values.iter().position(|(name, _)| *name == letter)?;
        Some(self.values.remove(place).1)
    }

    /// Rejects a second word with the same letter in a line, except G and M.
    pub(super) fn claim_letter(&mut self, letter: char) -> Result<(), Code> {
        if self.letters.contains(&letter) {
            return Err(25);
        }
        self.letters.push(letter);
        Ok(())
    }

    /// Rejects a second word of the same modal group in a line.
    pub(super) fn claim_group(&mut self, group: u8) -> Result<(), Code> {
        if self.groups.contains(&group) {
            return Err(21);
        }
        self.groups.push(group);
        Ok(())
    }
}
