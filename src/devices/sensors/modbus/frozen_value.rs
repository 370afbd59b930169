//! Detects a value that never changes, for sensors without a counter. If the noise of a sensor is greater
//! than its counts, its value changes sooner or later; for any other sensor this cannot be detected.

use tokio::time::{Duration, Instant};

use super::register_map::SensorRegisterMap;
use machine::record::sensor::Sensor;

/// Number of equal values from which on a value counts as frozen, if it has also been unchanged for long enough.
const MIN_FROZEN_EQUAL_VALUES: u32 = 20;
/// Smallest standard deviation of the noise, in counts, for which a frozen value can be detected: with less noise a
/// good value may repeat again and again.
const MIN_DETECTION_NOISE_SD_COUNTS: f64 = 4.0;

/// Detects a value that has been exactly equal for too many reads and for too long.
pub(super) struct FrozenValueDetector {
    /// Time for which equal values are not yet frozen: the sensor's timeout.
    min_unchanged_time: Duration,
    last_value_mm: f64,
    /// Time of the first of the equal values.
    unchanged_since: Instant,
    /// Number of equal values up to now, the first one included.
    pub equal_value_count: u32,
    /// Whether the last value counts as frozen: equal in at least `MIN_FROZEN_EQUAL_VALUES` reads and for
    /// `min_unchanged_time`.
    pub is_frozen: bool,
}

impl FrozenValueDetector {
    /// Returns the detector; `None` if the noise is unknown or too small, or if there is a counter.
    pub fn new_if_detectable(map: &SensorRegisterMap, sensor: &Sensor, timeout: Duration) -> Option<Self> {
        let noise_mm = 1e-3 * sensor.noise_um.filter(|noise| *noise > 0.0)?;
        let is_detectable = map.sample_layout.counter_modulus().is_none()
            && MIN_DETECTION_NOISE_SD_COUNTS * map.count_size_mm() <= noise_mm;
        is_detectable.then(|| Self {
            min_unchanged_time: timeout,
            last_value_mm: f64::NAN,
            unchanged_since: Instant::now(),
            equal_value_count: 0,
            is_frozen: false,
        })
    }

    /// Adds `value_mm`, which was read at `now`. Returns whether it is equal to the values before, in at least
    /// `MIN_FROZEN_EQUAL_VALUES` reads and for `min_unchanged_time`.
    pub fn detect_frozen(&mut self, value_mm: f64, now: Instant) -> bool {
        if value_mm != self.last_value_mm {
            *self = Self { last_value_mm: value_mm, unchanged_since: now, equal_value_count: 0, ..*self };
        }
        self.equal_value_count = self.equal_value_count.saturating_add(1);
        self.is_frozen =
            self.equal_value_count >= MIN_FROZEN_EQUAL_VALUES && now - self.unchanged_since >= self.min_unchanged_time;
        self.is_frozen
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn value_is_frozen_after_many_equal_samples_over_time() {
        let timeout = Duration::from_secs(1);
        let start = Instant::now();
        let (value_mm, unchanged_since) = (f64::NAN, start);
        let mut detector = FrozenValueDetector {
            min_unchanged_time: timeout,
            last_value_mm: value_mm,
            unchanged_since,
            equal_value_count: 0,
            is_frozen: false,
        };
        let at = |ms: u64| start + Duration::from_millis(ms);
        // Many equal values, but within a short time.
        assert!((0..200).all(|n| !detector.detect_frozen(1.5, at(n))));
        assert!(detector.detect_frozen(1.5, at(1000)));
        // A long time, but few equal values.
        assert!((0..19).all(|n| !detector.detect_frozen(1.6, at(2000 + 500 * n))));
        assert!(detector.detect_frozen(1.6, at(20_000)));
        assert!(!detector.detect_frozen(1.5, at(20_001)));
    }
}
