//! Conversion of the kernel's time stamps. The kernel stamps frames with the host's real-time clock, which may be
//! set at any time; samples have monotonic time. The age of a frame at the moment of reading is equal on both clocks.

use std::sync::Arc;
use std::time::SystemTime;

use crate::Clock;

pub(super) struct TimestampConverter {
    clock: Arc<dyn Clock>,
    last_returned_s: f64,
}

/// Maximum age of a frame in the kernel's buffer, s. A greater age means that the real-time clock was set meanwhile;
/// the frame then gets the time of reading.
const MAX_TRUSTED_STAMP_AGE_S: f64 = 60.0;

impl TimestampConverter {
    pub(super) fn new(clock: Arc<dyn Clock>) -> Self {
        Self { clock, last_returned_s: f64::NEG_INFINITY }
    }

    /// Monotonic time, s, of a frame that has the stamp `stamp` and is read now; the present time without a plausible
    /// stamp. Never decreases.
    pub(super) fn monotonic_time_s(&mut self, stamp: Option<SystemTime>) -> f64 {
        let (now, now_s) = (SystemTime::now(), self.clock.now_s());
        let age = stamp.and_then(|stamp| now.duration_since(stamp).ok());
        let age_s = age.map_or(0.0, |age| age.as_secs_f64());
        let age_s = if age_s < MAX_TRUSTED_STAMP_AGE_S { age_s } else { 0.0 };
        self.last_returned_s = self.last_returned_s.max(now_s - age_s);
        self.last_returned_s
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    struct StoppedClock(f64);

    impl Clock for StoppedClock {
        fn now_s(&self) -> f64 {
            self.0
        }
    }

    #[test]
    fn stamp_age_gives_the_frame_time_unless_the_clock_was_set() {
        let mut stamps = TimestampConverter::new(Arc::new(StoppedClock(100.0)));
        let old = SystemTime::now() - Duration::from_secs(2);
        let time_s = stamps.monotonic_time_s(Some(old));
        assert!((97.0..=98.0).contains(&time_s), "{time_s}");
        assert!(stamps.monotonic_time_s(Some(old - Duration::from_secs(1))) >= time_s, "never back");
        let future = SystemTime::now() + Duration::from_secs(3600);
        assert_eq!(stamps.monotonic_time_s(Some(future)), 100.0);
        let past = SystemTime::now() - Duration::from_secs(3600);
        assert_eq!(stamps.monotonic_time_s(Some(past)), 100.0);
        assert_eq!(stamps.monotonic_time_s(None), 100.0);
    }
}
