//! Whether a control that answers gets anywhere.

use std::time::Duration;

use tokio::time::Instant;

use super::fault::silent;
use super::patience::Patience;
use super::status::{State, Status};
use crate::controllers::ControllerError;

/// While nothing is read the heartbeat is not seen: of the time between two reads no more than this counts.
const MAX_PAUSE: Duration = Duration::from_millis(500);

/// The control's heartbeat, over all chunks.
#[derive(Default)]
pub(super) struct Heart {
    /// The last value, and when it was read.
    last: Option<(u16, Instant)>,
    /// How long it has been read as the same.
    stood: Duration,
}

impl Heart {
    /// One that stands: what the control shows is old.
    pub(super) fn look(&mut self, beat: u16, patience: &Patience) -> Result<(), ControllerError> {
        let now = Instant::now();
        self.stood = match self.last.replace((beat, now)) {
            Some((last, read)) if last == beat => self.stood + MAX_PAUSE.min(now - read),
            _ => Duration::ZERO,
        };
        if self.stood > patience.heartbeat { Err(ControllerError::Frozen) } else { Ok(()) }
    }
}

/// One chunk.
#[derive(Default)]
pub(super) struct Watch(Option<(Status, Instant)>);

impl Watch {
    /// Idle with a chunk that is not done: it was forgotten. Moving without moving: it hangs.
    pub(super) fn look(
        &mut self,
        status: &Status,
        patience: &Patience,
        still: Duration,
        line: &str,
    ) -> Result<(), ControllerError> {
        let same = |(last, _): &(Status, Instant)| {
            last.state == status.state && last.position == status.position
        };
        let last = self.0.take().filter(same);
        let since = last.map_or_else(Instant::now, |(_, since)| since);
        self.0 = Some((status.clone(), since));
        let limit = if status.state == State::Idle { patience.answer } else { patience.stall };
        if since.elapsed() > limit + still { Err(silent(line, limit)) } else { Ok(()) }
    }
}
