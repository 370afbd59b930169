//! How much came from a sensor, and how much did not.

use std::fmt;

use super::Sample;
use machine::record::reading::Flag;

/// Of all that its task has been asked for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tally {
    /// Samples that somebody waited for, and got.
    pub came: u64,
    /// Between them, as the sensor's counter says.
    pub missing: u64,
    /// Times at which none came within the sensor's time-out.
    pub silences: u64,
    /// So many at least came while nobody listened, as the counter says.
    pub passed_over: u64,
}

impl Tally {
    pub(super) fn count(&mut self, sample: &Sample) {
        if sample.flag == Flag::Stale {
            self.silences += 1;
        } else {
            self.came += 1;
        }
        self.missing += u64::from(sample.missing);
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { came, missing, silences, passed_over } = self;
        write!(
            f,
            "{came} samples listened to, {missing} missing, {silences} silences, {passed_over} not \
             listened to"
        )
    }
}
