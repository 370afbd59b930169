//! Detects a value that never changes, for sensors without a counter. If the noise of a sensor is greater
//! than its counts, its value changes sooner or later; for any other sensor this cannot be detected.

use tokio::time::{Duration, Instant};

use super::map::SensorRegisterMap;
use machine::record::sensor::Sensor;

/// Number of equal values after which a value counts as unchanged, if the timeout has passed too.
const MIN_EQUAL_VALUES: u32 = 20;
/// Smallest standard deviation of the noise, in counts: with less noise a value may repeat again and again.
const MIN_NOISE_COUNTS: f64 = 4.0;

pub(super) struct FrozenValueDetector {
    timeout: Duration,
    value_mm: f64,
    unchanged_since: Instant,
    /// Number of equal values up to now.
    pub repeat_count: u32,
    /// Whether the last value had been unchanged for too long.
    pub is_frozen: bool,
}

impl FrozenValueDetector {
    /// Returns the detector; `None` if detection is impossible, or if there is a counter.
    pub fn for_sensor(map: &SensorRegisterMap, sensor: &Sensor, timeout: Duration) -> Option<Self> {
        let noise_mm = 1e-3 * sensor.noise_um.filter(|noise| *noise > 0.0)?;
        let is_detectable = map.sample.counter_modulus().is_none() && MIN_NOISE_COUNTS * map.count_mm() <= noise_mm;
        let (value_mm, unchanged_since) = (f64::NAN, Instant::now());
        is_detectable.then_some(Self { timeout, value_mm, unchanged_since, repeat_count: 0, is_frozen: false })
    }

    /// Whether the value has been unchanged for too long; `value_mm` was read at `now`.
    pub fn check_value(&mut self, value_mm: f64, now: Instant) -> bool {
        if value_mm != self.value_mm {
            *self = Self { value_mm, unchanged_since: now, repeat_count: 0, ..*self };
        }
        self.repeat_count = self.repeat_count.saturating_add(1);
        self.is_frozen = self.repeat_count >= MIN_EQUAL_VALUES && now - self.unchanged_since >= self.timeout;
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
        let mut detector =
            FrozenValueDetector { timeout, value_mm, unchanged_since, repeat_count: 0, is_frozen: false };
        let at = |ms: u64| start + Duration::from_millis(ms);
        // Many equal values, but within a short time.
        assert!((0..200).all(|n| !detector.check_value(1.5, at(n))));
        assert!(detector.check_value(1.5, at(1000)));
        // A long time, but few equal values.
        assert!((0..19).all(|n| !detector.check_value(1.6, at(2000 + 500 * n))));
        assert!(detector.check_value(1.6, at(20_000)));
        assert!(!detector.check_value(1.5, at(20_001)));
    }
}
