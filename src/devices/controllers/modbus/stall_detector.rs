//! Detects a control that answers but makes no progress.

use std::time::Duration;

use tokio::time::Instant;

use super::fault::no_reply_error;
use super::status::{WindowState, WindowStatus};
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

/// Progress of one chunk.
#[derive(Default)]
pub(super) struct StallDetector(Option<(WindowStatus, Instant)>);

impl StallDetector {
    /// Error if the control is idle with an incomplete chunk (the chunk was lost), or if it reports a
    /// motion without a change of position (it hangs).
    pub(super) fn check_progress(
        &mut self,
        status: &WindowStatus,
        timeouts: &ModbusTimeouts,
        rest_time: Duration,
        line: &str,
    ) -> Result<(), ControllerError> {
        let same = |(last, _): &(WindowStatus, Instant)| last.state == status.state && last.position == status.position;
        let last = self.0.take().filter(same);
        let since = last.map_or_else(Instant::now, |(_, since)| since);
        self.0 = Some((status.clone(), since));
        let limit = if status.state == WindowState::Idle { timeouts.reply } else { timeouts.stall };
        if since.elapsed() > limit + rest_time { Err(no_reply_error(line, limit)) } else { Ok(()) }
    }
}
