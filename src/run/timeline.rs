//! Clock of the readings. It is one clock for the whole run, also if the run is resumed in another process or
//! on a control whose own clock has restarted.

use std::time::Instant;

/// Conversion from the time of this session's control to the time of the run, s.
#[derive(Debug)]
pub(super) struct Timeline {
    /// Monotonic time at which this session began: the start of the run, or its resumption.
    session_start: Instant,
    /// Time of the run at `session_start`, s, if it was resumed. `None`: a new run; the control's own time is used.
    resumed_at_run_time_s: Option<f64>,
    /// Time of the run minus time of the control, s: 0 in a new run; in a resumed run set by the first conversion and
    /// constant from then on.
    time_in_run_minus_control_time_s: Option<f64>,
}

impl Timeline {
    /// Timeline of a new run: the time of the control is the time of the run.
    pub fn new() -> Self {
        Self { session_start: Instant::now(), resumed_at_run_time_s: None, time_in_run_minus_control_time_s: Some(0.0) }
    }

    /// Timeline of a run that is resumed `elapsed_s` (wall time) after its last reading at `last_s` (time of the
    /// run). A negative `elapsed_s` counts as 0.
    pub fn resumed_after(last_s: f64, elapsed_s: f64) -> Self {
        let start_s = Some(last_s + elapsed_s.max(0.0));
        Self { session_start: Instant::now(), resumed_at_run_time_s: start_s, time_in_run_minus_control_time_s: None }
    }

    /// Time of the run that corresponds to the time `control_time_s` of the control, s. The first call after a
    /// resumption determines the offset of all later calls; its `control_time_s` must be the present time of the
    /// control.
    pub fn control_to_run_time_s(&mut self, control_time_s: f64) -> f64 {
        let (started, start) = (self.session_start, self.resumed_at_run_time_s.unwrap_or(control_time_s));
        let offset = self
            .time_in_run_minus_control_time_s
            .get_or_insert_with(|| start + started.elapsed().as_secs_f64() - control_time_s);
        control_time_s + *offset
    }
}
