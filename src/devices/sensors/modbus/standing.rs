//! Where no counter tells one measurement from the next: a value that never changes. A sensor whose noise
//! is finer than its counts says something else sooner or later; of any other one nobody can know.

use tokio::time::{Duration, Instant};

use super::map::Map;
use machine::record::sensor::Sensor;

/// So many times the same, and for as long as it may say nothing.
const SAME: u32 = 20;
/// Counts of a standard deviation of its noise: of fewer the same one may come again and again.
const COUNTS: f64 = 4.0;

pub(super) struct Standing {
    patience: Duration,
    value_mm: f64,
    since: Instant,
    times: u32,
    stood: bool,
}

impl Standing {
    /// `None`: it cannot be seen, or a counter sees it.
    pub fn of(map: &Map, sensor: &Sensor, patience: Duration) -> Option<Self> {
        let noise_mm = 1e-3 * sensor.noise_um.filter(|noise| *noise > 0.0)?;
        let seen = map.round().is_none() && COUNTS * map.count_mm() <= noise_mm;
        let (value_mm, since) = (f64::NAN, Instant::now());
        seen.then_some(Self { patience, value_mm, since, times: 0, stood: false })
    }

    /// Whether it has stood for too long, `value_mm` being what was read `now`.
    pub fn sees(&mut self, value_mm: f64, now: Instant) -> bool {
        if value_mm != self.value_mm {
            *self = Self { value_mm, since: now, times: 0, ..*self };
        }
        self.times = self.times.saturating_add(1);
        self.stood = self.times >= SAME && now - self.since >= self.patience;
        self.stood
    }

    /// What was read last had stood for too long.
    pub fn stood(&self) -> bool {
        self.stood
    }

    /// So many have been the same up to now.
    pub fn times(&self) -> u32 {
        self.times
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_stands_once_it_came_often_and_for_long() {
        let patience = Duration::from_secs(1);
        let begun = Instant::now();
        let (value_mm, since) = (f64::NAN, begun);
        let mut standing = Standing { patience, value_mm, since, times: 0, stood: false };
        let at = |ms: u64| begun + Duration::from_millis(ms);
        // Often, but not for long.
        assert!((0..200).all(|n| !standing.sees(1.5, at(n))));
        assert!(standing.sees(1.5, at(1000)));
        // For long, but not often.
        assert!((0..19).all(|n| !standing.sees(1.6, at(2000 + 500 * n))));
        assert!(standing.sees(1.6, at(20_000)));
        assert!(!standing.sees(1.5, at(20_001)));
    }
}
