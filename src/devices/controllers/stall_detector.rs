//! Detects a control that answers but makes no progress.

use std::time::Duration;

use tokio::time::Instant;

use crate::controllers::ControllerError;

/// State that a control reports, and the time of the first report of this state.
pub(in crate::controllers) struct StallDetector<State>(Option<(State, Instant)>);

impl<State: PartialEq> StallDetector<State> {
    pub fn new() -> Self {
        Self(None)
    }

    /// Error if the control has reported `state` for longer than `max_stall_time` plus `planned_standstill`, the
    /// standstill that `line` commands. The error names `line`.
    pub fn check_not_stalled(
        &mut self,
        state: State,
        max_stall_time: Duration,
        planned_standstill: Duration,
        line: &str,
    ) -> Result<(), ControllerError> {
        let last = self.0.take().filter(|(last, _)| *last == state);
        let since = last.map_or_else(Instant::now, |(_, since)| since);
        self.0 = Some((state, since));
        if since.elapsed() > max_stall_time + planned_standstill {
            return Err(ControllerError::no_answer(line, max_stall_time));
        }
        Ok(())
    }
}
