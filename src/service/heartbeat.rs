//! Heartbeat of a machine's worker.

use std::time::{Duration, Instant};

/// Newest heartbeat of a machine's worker: each beat states the maximum time until the next beat. Only progress of the
/// work causes a beat, so that hung work is detected.
#[derive(Debug, Clone, Copy)]
pub(super) struct Heartbeat {
    beat_time: Instant,
    /// Maximum time until the next beat.
    max_interval: Duration,
}

impl Heartbeat {
    /// A beat now; the next one is due within `max_interval`.
    pub(super) fn now(max_interval: Duration) -> Self {
        Self { beat_time: Instant::now(), max_interval }
    }

    /// Time since the beat.
    pub(super) fn age(self) -> Duration {
        self.beat_time.elapsed()
    }

    /// Whether the next beat is overdue.
    pub(super) fn is_late(self) -> bool {
        self.age() > self.max_interval
    }
}
