//! Heartbeat of a machine's worker: each beat states the maximum time until the next one. Only progress of the
//! work itself beats, so that hung work is detected.

use std::time::{Duration, Instant};

use super::command_gate::CommandGate;

/// The newest beat.
#[derive(Debug, Clone, Copy)]
pub(super) struct Heartbeat {
    time: Instant,
    /// Maximum time until the next beat.
    timeout: Duration,
}

impl Heartbeat {
    /// A beat now; the next one is due within `timeout`.
    pub(super) fn now(timeout: Duration) -> Self {
        Self { time: Instant::now(), timeout }
    }
}

impl CommandGate {
    /// Reports progress; the next report is due within `timeout`.
    pub fn report_progress(&self, timeout: Duration) {
        self.inner().heartbeat = Heartbeat::now(timeout);
    }

    /// Time since the last report of progress.
    pub fn progress_age(&self) -> Duration {
        self.inner().heartbeat.time.elapsed()
    }

    pub fn is_progress_late(&self) -> bool {
        let Heartbeat { time, timeout } = self.inner().heartbeat;
        time.elapsed() > timeout
    }
}
