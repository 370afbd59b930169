//! Converts a sensor's values to samples and follows its counter: missing samples are counted, and no
//! sample is used twice. Shared by all sensors.

use super::Sample;
use super::layout::Decoded;
use machine::record::reading::Flag;

/// Follows the counter of a sensor that sends a value and a count.
pub struct CounterTracker {
    /// Number of samples after which the counter restarts.
    round: Option<u64>,
    /// Count of the previous sample.
    count: Option<u64>,
    /// Whether data were lost since the last sample, by an amount that no counter shows.
    broken: bool,
    /// Whether the samples between the last one and the next were not requested.
    fresh: bool,
    /// Whether the last sample had the count of the sample before it.
    stands: bool,
    /// Whether so much time has passed that the counter may have wrapped to the same count.
    long: bool,
    /// Number of samples that were not requested, as far as the counter shows.
    passed_over: u64,
}

enum Step {
    On { missing: u32 },
    Stands,
}

impl CounterTracker {
    pub fn new(round: Option<u64>) -> Self {
        let (count, broken, fresh) = (None, false, true);
        let (stands, long, passed_over) = (false, false, 0);
        Self { round, count, broken, fresh, stands, long, passed_over }
    }

    /// Records that samples may be missing before the next one.
    pub fn interrupted(&mut self) {
        self.broken = true;
    }

    /// Records that samples between the last one and the next do not count as missing. An unchanged count
    /// is still detected.
    pub fn forget(&mut self) {
        (self.broken, self.fresh) = (false, true);
    }

    /// Records that samples between the last one and the next do not count as missing, however many they
    /// are.
    pub fn pass(&mut self) {
        self.forget();
        self.long = true;
    }

    pub fn passed_over(&self) -> u64 {
        self.passed_over
    }

    /// Starts anew with the next sample: a narrow counter may have wrapped to the same count.
    pub fn begin(&mut self) {
        self.forget();
        self.count = None;
    }

    /// Whether the last sample had an unchanged count: it is an old sample.
    pub fn stands(&self) -> bool {
        self.stands
    }

    pub fn follow(&mut self, t_s: f64, decoded: Decoded) -> Sample {
        let Decoded { value, counter, encoder_count } = decoded;
        let step = match counter {
            Some(count) => self.step(count),
            None => Step::On { missing: 0 },
        };
        self.stands = matches!(step, Step::Stands);
        let Step::On { missing } = step else {
            return Sample::stale(t_s);
        };
        let broken = std::mem::take(&mut self.broken) || missing > 0;
        let flag = value.err().unwrap_or(if broken { Flag::Gap } else { Flag::None });
        Sample { t_s, value_mm: value.ok(), flag, missing, encoder_count }
    }

    fn step(&mut self, count: u64) -> Step {
        let (fresh, long) = (std::mem::take(&mut self.fresh), std::mem::take(&mut self.long));
        let Some(last) = self.count.replace(count) else { return Step::On { missing: 0 } };
        let round = self.round.unwrap_or(1);
        match (round + count - last) % round {
            // After an interruption the counter may have wrapped.
            0 if !self.broken && !long => Step::Stands,
            0 => Step::On { missing: 0 },
            on if fresh => {
                self.passed_over += on - 1;
                Step::On { missing: 0 }
            }
            on => Step::On { missing: u32::try_from(on - 1).unwrap_or(u32::MAX) },
        }
    }
}
