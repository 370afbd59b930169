//! Heartbeat of a machine's worker: each beat states the maximum time until the next one. Only progress of the
//! work itself beats, so that hung work is detected.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

#[derive(Debug, Clone)]
pub struct WorkerHeartbeat(Arc<Mutex<LastBeat>>);

#[derive(Debug)]
struct LastBeat {
    at: Instant,
    patience: Duration,
}

impl WorkerHeartbeat {
    /// Starts the heartbeat; the first beat is due within `patience`.
    pub fn new(patience: Duration) -> Self {
        Self(Arc::new(Mutex::new(LastBeat { at: Instant::now(), patience })))
    }

    fn last(&self) -> MutexGuard<'_, LastBeat> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reports progress; the next beat is due within `patience`.
    pub fn beat(&self, patience: Duration) {
        *self.last() = LastBeat { at: Instant::now(), patience };
    }

    /// Time since the last beat.
    pub fn age(&self) -> Duration {
        self.last().at.elapsed()
    }

    pub fn is_late(&self) -> bool {
        let last = self.last();
        last.at.elapsed() > last.patience
    }
}
