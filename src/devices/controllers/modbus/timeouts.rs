//! Timeouts of the exchange through the window.

use std::time::Duration;

use super::status::WindowState;

/// Timeouts of the driver, host time.
#[derive(Debug, Clone, Copy)]
pub struct ModbusTimeouts {
    /// Maximum time for the control to accept a chunk, and to report its state.
    pub reply: Duration,
    /// Longest pause between two requests. A contact in a move that should touch nothing must lead to a
    /// hold within `LATENCY_S` (planning, `turn_feeds.rs`).
    pub poll_interval: Duration,
    /// Maximum time for which a control may report a motion without a change of position.
    pub stall: Duration,
    /// Maximum time without a change of the control's heartbeat.
    pub heartbeat: Duration,
}

impl ModbusTimeouts {
    /// Maximum time for which a control may report `state` unchanged while a chunk is incomplete. An idle control
    /// has lost the chunk; one that reports a motion without a change of position hangs.
    pub(super) fn unchanged_limit(&self, state: WindowState) -> Duration {
        if state == WindowState::Idle { self.reply } else { self.stall }
    }
}

impl Default for ModbusTimeouts {
    fn default() -> Self {
        Self {
            reply: Duration::from_secs(4),
            poll_interval: Duration::from_millis(20),
            stall: Duration::from_secs(10),
            heartbeat: Duration::from_secs(2),
        }
    }
}
