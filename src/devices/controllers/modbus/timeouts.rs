//! Timeouts of the exchange through the window, and the monitor of the heartbeat of the control.

use std::time::Duration;

use tokio::time::Instant;

use super::status::WindowState;
use crate::controllers::ControllerError;

/// Timeouts of the driver, host time.
#[derive(Debug, Clone, Copy)]
pub struct ModbusTimeouts {
    /// Maximum time for the control to check a chunk, to report its state, and to come to rest after a hold.
    pub reply_timeout: Duration,
    /// Longest delay between two reads of the status. A contact in a move that should touch nothing must lead to a
    /// hold within `CONTACT_TO_HOLD_LATENCY_S` (planning, `turn_feeds.rs`).
    pub poll_interval: Duration,
    /// Maximum time, beyond a planned standstill, for which a control may report a motion without a change of
    /// position.
    pub stall_timeout: Duration,
    /// After this time with an unchanged heartbeat, the control counts as frozen.
    pub heartbeat_timeout: Duration,
}

impl ModbusTimeouts {
    /// Maximum time for which a control may report `state` unchanged while a chunk is incomplete. An idle control
    /// has lost the chunk; one that reports a motion without a change of position hangs.
    pub(super) fn max_unchanged_time(&self, state: WindowState) -> Duration {
        if state == WindowState::Idle { self.reply_timeout } else { self.stall_timeout }
    }
}

impl Default for ModbusTimeouts {
    fn default() -> Self {
        Self {
            reply_timeout: Duration::from_secs(4),
            poll_interval: Duration::from_millis(20),
            stall_timeout: Duration::from_secs(10),
            heartbeat_timeout: Duration::from_secs(2),
        }
    }
}

/// Largest part of the time between two reads that counts as time without a heartbeat: during a longer pause no
/// heartbeat can be read.
const MAX_COUNTED_READ_INTERVAL: Duration = Duration::from_millis(500);

/// Detects that the control's heartbeat has stopped; counts across chunks.
#[derive(Default)]
pub(super) struct HeartbeatMonitor {
    /// Heartbeat of the last read, and the time of that read (not of the last change).
    last_beat_and_last_read_time: Option<(u16, Instant)>,
    /// Time for which the same value was read; of each interval between two reads at most
    /// [`MAX_COUNTED_READ_INTERVAL`] counts.
    unchanged_time: Duration,
}

impl HeartbeatMonitor {
    /// Registers the heartbeat `beat` of a status; an error if the heartbeat has stopped: the status is outdated.
    pub(super) fn check_heartbeat(&mut self, beat: u16, timeouts: &ModbusTimeouts) -> Result<(), ControllerError> {
        let now = Instant::now();
        self.unchanged_time = match self.last_beat_and_last_read_time.replace((beat, now)) {
            Some((last, read)) if last == beat => self.unchanged_time + MAX_COUNTED_READ_INTERVAL.min(now - read),
            _ => Duration::ZERO,
        };
        if self.unchanged_time > timeouts.heartbeat_timeout { Err(ControllerError::ControlFrozen) } else { Ok(()) }
    }
}
