//! The readings' clock: one for the whole run, also when it goes on in another process or on a
//! control whose own clock began anew.

use std::time::Instant;

/// From the time of this session's control to the time of the run, s.
#[derive(Debug)]
pub(super) struct Timeline {
    since: Instant,
    /// What the run's clock shows at `since`; `None`: the control's own time counts.
    at_start_s: Option<f64>,
    /// Run's time minus control's time, once the first reading has told it.
    offset_s: Option<f64>,
}

impl Timeline {
    /// A run that begins: the control's time is the run's.
    pub fn new() -> Self {
        Self { since: Instant::now(), at_start_s: None, offset_s: Some(0.0) }
    }

    /// A run that goes on `elapsed_s` (wall time) after its last reading at `last_s`.
    pub fn after(last_s: f64, elapsed_s: f64) -> Self {
        let at_start_s = Some(last_s + elapsed_s.max(0.0));
        Self { since: Instant::now(), at_start_s, offset_s: None }
    }

    /// The run's time at the control's time `own_s`, just now.
    pub fn at(&mut self, own_s: f64) -> f64 {
        let (since, start) = (self.since, self.at_start_s.unwrap_or(own_s));
        let offset =
            self.offset_s.get_or_insert_with(|| start + since.elapsed().as_secs_f64() - own_s);
        own_s + *offset
    }
}
