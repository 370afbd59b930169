//! Detects a control that answers but makes no progress.

use std::time::Duration;

use tokio::time::Instant;

use super::fault::silent;
use super::patience::Patience;
use super::status::{State, Status};
use crate::controllers::ControllerError;

/// Maximum time between two reads that counts as time without a heartbeat: without a read no heartbeat is
/// seen.
const MAX_PAUSE: Duration = Duration::from_millis(500);

/// The control's heartbeat, over all chunks.
#[derive(Default)]
pub(super) struct Heart {
    /// Last value, and the time of its read.
    last: Option<(u16, Instant)>,
    /// Time for which the same value was read.
    stood: Duration,
}

impl Heart {
    /// Error if the heartbeat has stopped: the status is outdated.
    pub(super) fn look(&mut self, beat: u16, patience: &Patience) -> Result<(), ControllerError> {
        let now = Instant::now();
        self.stood = match self.last.replace((beat, now)) {
            Some((last, read)) if last == beat => self.stood + MAX_PAUSE.min(now - read),
            _ => Duration::ZERO,
        };
        if self.stood > patience.heartbeat { Err(ControllerError::Frozen) } else { Ok(()) }
    }
}

/// Progress of one chunk.
#[derive(Default)]
pub(super) struct Watch(Option<(Status, Instant)>);

impl Watch {
    /// Error if the control is idle with an incomplete chunk (the chunk was lost), or if it reports a
    /// motion without a change of position (it hangs).
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
