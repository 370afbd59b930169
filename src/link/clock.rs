//! Time as a seam: real machines use the host's monotonic clock, simulated ones their own.

use std::time::Instant;

/// Seconds since an arbitrary start; never goes back.
pub trait Clock: Send + Sync {
    fn now_s(&self) -> f64;
}

/// The host's monotonic clock, zero when made.
#[derive(Debug)]
pub struct HostClock(Instant);

impl HostClock {
    pub fn start() -> Self {
        Self(Instant::now())
    }
}

impl Clock for HostClock {
    fn now_s(&self) -> f64 {
        self.0.elapsed().as_secs_f64()
    }
}
