//! Converts a sensor's values to samples and follows its counter: missing samples are counted, and no
//! sample is used twice. Shared by all sensors.

use super::Sample;
use super::sample_layout::DecodedSample;
use machine::record::reading::ReadingFlag;

/// Follows the counter of a sensor that sends a value and a count.
#[derive(Default)]
pub struct CounterTracker {
    /// Number of samples after which the counter restarts.
    modulus: Option<u64>,
    /// Count of the previous sample.
    last_count: Option<u64>,
    /// Whether data were lost since the last sample, by an amount that no counter shows.
    data_lost: bool,
    /// Whether the samples between the last one and the next were not requested.
    skips_gap: bool,
    /// Whether the last sample had the count of the sample before it.
    is_unchanged: bool,
    /// Whether so much time has passed that the counter may have wrapped to the same count.
    may_have_wrapped: bool,
    /// Number of samples that were not requested, as far as the counter shows.
    unrequested_count: u64,
}

impl CounterTracker {
    pub fn new(modulus: Option<u64>) -> Self {
        Self { modulus, skips_gap: true, ..Self::default() }
    }

    /// Records that samples may be missing before the next one.
    pub fn mark_data_lost(&mut self) {
        self.data_lost = true;
    }

    /// Records that samples between the last one and the next do not count as missing. An unchanged count
    /// is still detected.
    pub fn skip_gap(&mut self) {
        (self.data_lost, self.skips_gap) = (false, true);
    }

    /// Records that samples between the last one and the next do not count as missing, however many they
    /// are.
    pub fn skip_gap_with_wrap(&mut self) {
        self.skip_gap();
        self.may_have_wrapped = true;
    }

    pub fn unrequested_count(&self) -> u64 {
        self.unrequested_count
    }

    /// Starts anew with the next sample: a narrow counter may have wrapped to the same count.
    pub fn restart(&mut self) {
        self.skip_gap();
        self.last_count = None;
    }

    /// Whether the last sample had an unchanged count: it is an old sample.
    pub fn is_unchanged(&self) -> bool {
        self.is_unchanged
    }

    pub fn complete_sample(&mut self, t_s: f64, decoded: DecodedSample) -> Sample {
        let DecodedSample { value, counter, encoder_count } = decoded;
        let missing = counter.map_or(Some(0), |count| self.count_missing(count));
        self.is_unchanged = missing.is_none();
        let Some(missing) = missing else { return Sample::stale(t_s) };
        let data_lost = std::mem::take(&mut self.data_lost) || missing > 0;
        let flag = value.err().unwrap_or(if data_lost { ReadingFlag::Gap } else { ReadingFlag::None });
        Sample { t_s, value_mm: value.ok(), flag, missing_count: missing, encoder_count }
    }

    /// Returns the number of samples missing before the one with `count`; `None` if the count is unchanged.
    fn count_missing(&mut self, count: u64) -> Option<u32> {
        let skips_gap = std::mem::take(&mut self.skips_gap);
        let may_have_wrapped = std::mem::take(&mut self.may_have_wrapped);
        let Some(last) = self.last_count.replace(count) else { return Some(0) };
        let modulus = self.modulus.unwrap_or(1);
        match (modulus + count - last) % modulus {
            // After an interruption the counter may have wrapped.
            0 if !self.data_lost && !may_have_wrapped => None,
            0 => Some(0),
            steps if skips_gap => {
                self.unrequested_count += steps - 1;
                Some(0)
            }
            steps => Some(u32::try_from(steps - 1).unwrap_or(u32::MAX)),
        }
    }
}
