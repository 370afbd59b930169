//! Timeouts: for silence of a control, and for a standstill while it should move.

use std::time::Duration;

use super::message::GrblStatus;

/// Timeouts of the driver, host time.
#[derive(Debug, Clone, Copy)]
pub struct GrblTimeouts {
    /// Maximum time for the answer to `?`.
    pub reply_timeout: Duration,
    /// Longest interval between two status requests of a waiting driver.
    pub poll_interval: Duration,
    /// Maximum delay of a message that belongs to the one before it: the number or the banner of an alarm, a status
    /// report after a motion.
    pub follow_up_timeout: Duration,
    /// Maximum time for which a control may report a motion without a change of position.
    pub stall_timeout: Duration,
}

/// Longest pause between two status requests during a move that should touch nothing. One request may be
/// lost: a contact must lead to a hold within `CONTACT_TO_HOLD_LATENCY_S` (planning, `turn_feeds.rs`), to which turns
/// limit their speed.
pub(super) const MAX_POSITIONING_POLL_INTERVAL: Duration = Duration::from_millis(100);

impl Default for GrblTimeouts {
    fn default() -> Self {
        Self {
            reply_timeout: Duration::from_secs(2),
            poll_interval: Duration::from_millis(200),
            follow_up_timeout: Duration::from_millis(500),
            stall_timeout: Duration::from_secs(10),
        }
    }
}

impl GrblTimeouts {
    /// Maximum time for which a control may report `status` unchanged. A control that is idle while an answer is
    /// outstanding has lost a byte; one that reports a motion without a change of position hangs.
    pub(super) fn max_unchanged_time(&self, status: &GrblStatus) -> Duration {
        if status.state == "Idle" { self.reply_timeout } else { self.stall_timeout }
    }
}
