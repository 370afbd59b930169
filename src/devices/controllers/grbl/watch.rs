//! How long a control may be silent, and stand while it should move.

use std::time::Duration;

use tokio::time::Instant;

use super::fault::silent;
use super::message::Status;
use crate::controllers::ControllerError;

/// How long the driver waits, host time.
#[derive(Debug, Clone, Copy)]
pub struct Patience {
    /// A living control answers `?` within this time.
    pub answer: Duration,
    /// How often a waiting driver asks whether the link lives.
    pub poll: Duration,
    /// What follows an alarm (`ok`, or a banner) comes within this time.
    pub aftermath: Duration,
    /// A control that says it moves shows another position within this time.
    pub stall: Duration,
}

/// The longest pause between two status requests during a move that should meet nothing. One request may
/// get lost: a contact must be a hold within `LATENCY_S` (planning, `turning.rs`), to which turns limit
/// their speed.
pub(super) const FREE_MOVE_POLL: Duration = Duration::from_millis(100);

impl Default for Patience {
    fn default() -> Self {
        Self {
            answer: Duration::from_secs(2),
            poll: Duration::from_millis(200),
            aftermath: Duration::from_millis(500),
            stall: Duration::from_secs(10),
        }
    }
}

/// Whether a control that answers gets anywhere.
#[derive(Default)]
pub(super) struct Watch(Option<(Status, Instant)>);

impl Watch {
    /// Idle with an answer outstanding: a byte got lost. Moving without moving: it hangs.
    pub(super) fn look(
        &mut self,
        status: &Status,
        patience: &Patience,
        still: Duration,
        line: &str,
    ) -> Result<(), ControllerError> {
        let same = |last: &&(Status, Instant)| {
            last.0.state == status.state && last.0.position == status.position
        };
        let since = self.0.as_ref().filter(same).map_or_else(Instant::now, |(_, since)| *since);
        self.0 = Some((status.clone(), since));
        let limit = if status.state == "Idle" { patience.answer } else { patience.stall };
        if since.elapsed() > limit + still { Err(silent(line, limit)) } else { Ok(()) }
    }
}
