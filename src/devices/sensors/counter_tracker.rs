//! Converts a sensor's values to samples and follows its counter: missing samples are counted, and no
//! sample is used twice. Shared by all sensors.

use super::Sample;
use super::sample_layout::DecodedSample;
use machine::record::reading::ReadingFlag;

/// Follows the sample counter of a sensor.
#[derive(Default)]
pub struct CounterTracker {
    /// Number of samples after which the counter restarts; `None`: the sensor has no counter.
    modulus: Option<u64>,
    /// Count of the previous sample.
    last_count: Option<u64>,
    /// Whether data were lost since the last sample, by an amount that no counter shows.
    has_lost_data: bool,
    /// Whether samples between the last one and the next do not count as missing, because they were not requested.
    ignores_next_gap: bool,
    /// Whether the last sample had the count of the sample before it.
    is_count_unchanged: bool,
    /// Whether so much time has passed that the counter may have wrapped to the same count.
    may_have_wrapped: bool,
    /// Number of samples in ignored gaps, as far as the counter shows: the sensor made them, but they were not
    /// requested.
    unrequested_count: u64,
}

impl CounterTracker {
    pub fn new(modulus: Option<u64>) -> Self {
        Self { modulus, ignores_next_gap: true, ..Self::default() }
    }

    /// Records that samples may be missing before the next one.
    pub fn mark_data_lost(&mut self) {
        self.has_lost_data = true;
    }

    /// Records that samples between the last one and the next were not requested and do not count as missing, and
    /// forgets an earlier loss. A next sample with an unchanged count is still recognised as an old one.
    pub fn ignore_next_gap(&mut self) {
        (self.has_lost_data, self.ignores_next_gap) = (false, true);
    }

    /// As `ignore_next_gap`, after so long a gap that the counter may have wrapped: a next sample with an unchanged
    /// count is a new one.
    pub fn ignore_next_gap_and_wrap(&mut self) {
        self.ignore_next_gap();
        self.may_have_wrapped = true;
    }

    /// Number of samples that the sensor made although they were not requested, as far as the counter shows.
    pub fn unrequested_count(&self) -> u64 {
        self.unrequested_count
    }

    /// Discards the last count: the next sample counts as new, and no sample before it counts as missing.
    pub fn restart(&mut self) {
        self.ignore_next_gap();
        self.last_count = None;
    }

    /// Whether the last sample had the same count as the sample before it, and therefore is an old sample.
    pub fn is_count_unchanged(&self) -> bool {
        self.is_count_unchanged
    }

    /// Converts `decoded`, received at `t_s`, to a sample. An unchanged count gives a stale sample without a value; a
    /// sample after a loss has the flag `Gap`, unless its value has another flag.
    pub fn complete_sample(&mut self, t_s: f64, decoded: DecodedSample) -> Sample {
        let DecodedSample { value_mm: value, counter_value: counter, wrapped_encoder_count: encoder_count } = decoded;
        let missing = counter.map_or(Some(0), |count| self.count_missing(count));
        self.is_count_unchanged = missing.is_none();
        let Some(missing) = missing else { return Sample::stale(t_s) };
        let data_lost = std::mem::take(&mut self.has_lost_data) || missing > 0;
        let flag = value.err().unwrap_or(if data_lost { ReadingFlag::Gap } else { ReadingFlag::None });
        Sample { received_s: t_s, value_mm: value.ok(), flag, lost_before_count: missing, encoder_count }
    }

    /// Returns the number of samples missing before the one with `count`; `None` if the count is unchanged.
    fn count_missing(&mut self, count: u64) -> Option<u32> {
        let skips_gap = std::mem::take(&mut self.ignores_next_gap);
        let may_have_wrapped = std::mem::take(&mut self.may_have_wrapped);
        let Some(last) = self.last_count.replace(count) else { return Some(0) };
        let modulus = self.modulus.unwrap_or(1);
        match (modulus + count - last) % modulus {
            // After an interruption the counter may have wrapped.
            0 if !self.has_lost_data && !may_have_wrapped => None,
            0 => Some(0),
            steps if skips_gap => {
                self.unrequested_count += steps - 1;
                Some(0)
            }
            steps => Some(u32::try_from(steps - 1).unwrap_or(u32::MAX)),
        }
    }
}
