//! Execution of the jobs of a simulated control by the simulated machine, one at a time.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::SimulatedWorld;
use crate::interpreter::{ActiveJob, Job, JobResult, ProbeInputFault, SimulationPace};
use machine::Position;

/// Number of status reports in which a brushed stylus reads closed: two, because one may be lost on a bad wire.
const BRUSH_REPORT_COUNT: u8 = 2;

/// The machine of a simulated control, its current job (one move, probing move, dwell or spindle orientation) and its
/// probe input.
pub(super) struct JobExecutor {
    world: Arc<Mutex<SimulatedWorld>>,
    pace: SimulationPace,
    pub active_job: Option<ActiveJob>,
    /// Present fault of the probe input.
    pub probe_fault: ProbeInputFault,
}

impl JobExecutor {
    pub fn new(world: Arc<Mutex<SimulatedWorld>>, pace: SimulationPace) -> Self {
        Self { world, pace, active_job: None, probe_fault: ProbeInputFault::default() }
    }

    pub fn with_world<T>(&self, act: impl FnOnce(&mut SimulatedWorld) -> T) -> T {
        // The world is plain data: a panic elsewhere leaves it consistent.
        act(&mut self.world.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Displayed position in the world: that at the start of the active job, if there is one.
    pub fn displayed_position(&self) -> Position {
        self.with_world(|world| world.displayed_position())
    }

    /// Displayed position at `now`, during the active job as well.
    pub fn displayed_position_at(&self, now: Duration) -> Position {
        self.active_job.as_ref().map_or_else(|| self.displayed_position(), |active| active.position_at(now))
    }

    /// Whether the probe input reads closed.
    pub fn is_probe_closed(&self) -> bool {
        self.with_world(|world| self.probe_fault.is_probe_closed(world))
    }

    /// Updates the probe fault after a report that contained the probe state.
    pub fn on_probe_state_reported(&mut self) {
        self.probe_fault = self.probe_fault.after_report();
    }

    /// Starts a job; returns whether it brushes the stylus.
    pub fn start_job_and_check_brush(&mut self, job: Job, now: Duration) -> bool {
        let is_brushed = self.probe_fault == ProbeInputFault::BrushPending && job.is_rapid_or_rotary_move();
        if is_brushed {
            self.probe_fault = ProbeInputFault::BrushedForReports(BRUSH_REPORT_COUNT);
        }
        self.active_job = Some(self.with_world(|world| ActiveJob::start(job, world, self.probe_fault, self.pace, now)));
        is_brushed
    }

    /// Applies the whole active job to the world; returns the job and its result. `None`: no job is active.
    pub fn finish_job(&mut self) -> Option<(Job, JobResult)> {
        let active = self.active_job.take()?;
        let result = self.with_world(|world| active.job.run(world, self.probe_fault));
        Some((active.job, result))
    }

    /// Stops the active job at its current position; returns the remaining job. `None`: no job is active.
    pub fn hold_job(&mut self, now: Duration) -> Option<Job> {
        let active = self.active_job.take()?;
        Some(self.with_world(|world| active.hold(world, now)))
    }

    /// Removes the obstacle after a probing move; returns whether there was one.
    pub fn remove_obstacle(&mut self) -> bool {
        let was_present = self.probe_fault == ProbeInputFault::ObstacleOnNextProbe;
        if was_present {
            self.probe_fault = ProbeInputFault::NoFault;
        }
        was_present
    }
}
