//! Clock trait: real machines use the host's monotonic clock, simulated machines their own.

use std::time::Instant;

/// Time in seconds since an arbitrary start. Never decreases.
pub trait Clock: Send + Sync {
    fn now_s(&self) -> f64;
}

/// The host's monotonic clock; zero at creation.
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
