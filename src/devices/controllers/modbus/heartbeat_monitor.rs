//! Detects a control whose program has stopped.

use std::time::Duration;

use tokio::time::Instant;

use super::timeouts::ModbusTimeouts;
use crate::controllers::ControllerError;

/// Maximum time between two reads that counts as time without a heartbeat: without a read no heartbeat is
/// seen.
const MAX_COUNTED_READ_INTERVAL: Duration = Duration::from_millis(500);

/// The control's heartbeat, over all chunks.
#[derive(Default)]
pub(super) struct HeartbeatMonitor {
    /// Last value, and the time of its read.
    last: Option<(u16, Instant)>,
    /// Time for which the same value was read.
    unchanged_time: Duration,
}

impl HeartbeatMonitor {
    /// Error if the heartbeat has stopped: the status is outdated.
    pub(super) fn check_heartbeat(&mut self, beat: u16, timeouts: &ModbusTimeouts) -> Result<(), ControllerError> {
        let now = Instant::now();
        self.unchanged_time = match self.last.replace((beat, now)) {
            Some((last, read)) if last == beat => self.unchanged_time + MAX_COUNTED_READ_INTERVAL.min(now - read),
            _ => Duration::ZERO,
        };
        if self.unchanged_time > timeouts.heartbeat { Err(ControllerError::Frozen) } else { Ok(()) }
    }
}
