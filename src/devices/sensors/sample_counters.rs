//! Counts of a sensor's received, lost, stale and unrequested samples.

use std::fmt;

use super::Sample;
use machine::record::reading::ReadingFlag;

/// Counts of samples over all requests to the sensor's task.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SampleCounters {
    /// Number of samples that reads and watches have received, without the stale ones; samples for display do not
    /// count.
    pub received_count: u64,
    /// Number of samples lost between the received ones, by the sensor's counter.
    pub lost_sample_count: u64,
    /// Number of samples with the flag `Stale`: no sample came within the sensor's timeout, or an old one.
    pub stale_count: u64,
    /// Minimum number of samples that came without being requested, by the counter.
    pub unrequested_count: u64,
}

impl SampleCounters {
    pub(super) fn count_sample(&mut self, sample: &Sample) {
        if sample.flag == ReadingFlag::Stale {
            self.stale_count += 1;
        } else {
            self.received_count += 1;
        }
        self.lost_sample_count += u64::from(sample.lost_before_count);
    }
}

impl fmt::Display for SampleCounters {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { received_count, lost_sample_count, stale_count, unrequested_count } = self;
        write!(
            f,
            "{received_count} samples received, {lost_sample_count} missing, {stale_count} timeouts, \
             {unrequested_count} not requested"
        )
    }
}
