//! Whether a control that answers gets anywhere.

use std::time::Duration;

use tokio::time::Instant;

use super::fault::silent;
use super::patience::Patience;
use super::status::{State, Status};
use crate::controllers::ControllerError;

#[derive(Default)]
pub(super) struct Watch {
    moved: Option<(Status, Instant)>,
    beaten: Option<(u16, Instant)>,
}

impl Watch {
    /// Idle with a chunk that is not done: it was forgotten. Moving without moving: it hangs. No
    /// heartbeat: what it shows is old.
    pub(super) fn look(
        &mut self,
        status: &Status,
        patience: &Patience,
        still: Duration,
        line: &str,
    ) -> Result<(), ControllerError> {
        let beat = self.beaten.filter(|(beat, _)| *beat == status.heartbeat);
        let (_, since) = *self.beaten.insert(beat.unwrap_or((status.heartbeat, Instant::now())));
        if since.elapsed() > patience.heartbeat {
            return Err(ControllerError::Frozen);
        }
        let same = |(last, _): &(Status, Instant)| {
            last.state == status.state && last.position == status.position
        };
        let last = self.moved.take().filter(same);
        let since = last.map_or_else(Instant::now, |(_, since)| since);
        self.moved = Some((status.clone(), since));
        let limit = if status.state == State::Idle { patience.answer } else { patience.stall };
        if since.elapsed() > limit + still { Err(silent(line, limit)) } else { Ok(()) }
    }
}
