//! The sign of life of whoever works at a machine: each step on its way says how long the next may take.
//! Nothing beats by itself, so that work that hangs is found out.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

#[derive(Debug, Clone)]
pub struct Pulse(Arc<Mutex<Beat>>);

#[derive(Debug)]
struct Beat {
    at: Instant,
    patience: Duration,
}

impl Pulse {
    /// The first beat is within `patience`.
    pub fn new(patience: Duration) -> Self {
        Self(Arc::new(Mutex::new(Beat { at: Instant::now(), patience })))
    }

    fn last(&self) -> MutexGuard<'_, Beat> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Something is done; the next is within `patience`.
    pub fn beat(&self, patience: Duration) {
        *self.last() = Beat { at: Instant::now(), patience };
    }

    /// Since the last beat.
    pub fn age(&self) -> Duration {
        self.last().at.elapsed()
    }

    pub fn is_late(&self) -> bool {
        let last = self.last();
        last.at.elapsed() > last.patience
    }
}
