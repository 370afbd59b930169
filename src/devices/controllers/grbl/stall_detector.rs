//! Timeouts: for silence of a control, and for a standstill while it should move.

use std::time::Duration;

use tokio::time::Instant;

use super::fault::no_reply_error;
use super::message::GrblStatus;
use crate::controllers::ControllerError;

/// Timeouts of the driver, host time.
#[derive(Debug, Clone, Copy)]
pub struct GrblTimeouts {
    /// Maximum time for the answer to `?`.
    pub reply: Duration,
    /// Interval at which a waiting driver checks the link.
    pub poll_interval: Duration,
    /// Maximum time for what follows an alarm (`ok`, or a banner).
    pub after_alarm: Duration,
    /// Maximum time for which a control may report a motion without a change of position.
    pub stall: Duration,
}

/// Longest pause between two status requests during a move that should touch nothing. One request may be
/// lost: a contact must lead to a hold within `LATENCY_S` (planning, `turn_feeds.rs`), to which turns limit
/// their speed.
pub(super) const MAX_FREE_MOVE_POLL: Duration = Duration::from_millis(100);

impl Default for GrblTimeouts {
    fn default() -> Self {
        Self {
            reply: Duration::from_secs(2),
            poll_interval: Duration::from_millis(200),
            after_alarm: Duration::from_millis(500),
            stall: Duration::from_secs(10),
        }
    }
}

/// Detects a control that answers but makes no progress.
#[derive(Default)]
pub(super) struct StallDetector(Option<(GrblStatus, Instant)>);

impl StallDetector {
    /// Error if the control is idle while an answer is outstanding (a byte was lost), or if it reports a
    /// motion without a change of position (it hangs).
    pub(super) fn check_progress(
        &mut self,
        status: &GrblStatus,
        timeouts: &GrblTimeouts,
        rest_time: Duration,
        line: &str,
    ) -> Result<(), ControllerError> {
        let same = |last: &&(GrblStatus, Instant)| last.0.state == status.state && last.0.position == status.position;
        let since = self.0.as_ref().filter(same).map_or_else(Instant::now, |(_, since)| *since);
        self.0 = Some((status.clone(), since));
        let limit = if status.state == "Idle" { timeouts.reply } else { timeouts.stall };
        if since.elapsed() > limit + rest_time { Err(no_reply_error(line, limit)) } else { Ok(()) }
    }
}
