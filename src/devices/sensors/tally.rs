//! Counts of the samples that came from a sensor, and of those that did not.

use std::fmt;

use super::Sample;
use machine::record::reading::Flag;

/// Counts over all requests to the sensor's task.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tally {
    /// Number of samples that were requested and received.
    pub came: u64,
    /// Number of samples missing between them, by the sensor's counter.
    pub missing: u64,
    /// Number of times that no sample came within the sensor's timeout.
    pub silences: u64,
    /// Minimum number of samples that came without being requested, by the counter.
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
