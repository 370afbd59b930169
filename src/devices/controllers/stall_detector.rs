//! Detects a control that answers but makes no progress.

use std::time::Duration;

use tokio::time::Instant;

use crate::controllers::ControllerError;

/// Time for which a control reports the same `State`.
pub(in crate::controllers) struct StallDetector<State>(Option<(State, Instant)>);

impl<State: PartialEq> StallDetector<State> {
    pub fn new() -> Self {
        Self(None)
    }

    /// Error if `line` is executed and the control has reported `state` for longer than `limit` and `standstill_time`.
    pub fn check_progress(
        &mut self,
        state: State,
        limit: Duration,
        standstill_time: Duration,
        line: &str,
    ) -> Result<(), ControllerError> {
        let last = self.0.take().filter(|(last, _)| *last == state);
        let since = last.map_or_else(Instant::now, |(_, since)| since);
        self.0 = Some((state, since));
        if since.elapsed() > limit + standstill_time { Err(ControllerError::no_answer(line, limit)) } else { Ok(()) }
    }
}
