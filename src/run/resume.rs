//! Resuming a run after a stop: an operator has acknowledged the stop, the references are measured again and
//! compared, and the run continues with the first touch that has no reading.

use super::timeline::Timeline;
use super::{Run, RunError};
use crate::store::RunState;
use machine::Position;
use machine::record::event::RunEvent;
use machine::record::plan::{FIRST_REPEAT_NUMBER_AFTER_STOP, Plan, Stage};
use machine::record::reading::Reading;
use methods::decision::reference_check::ReferencePoints;
use methods::decision::reference_shifts::{ReferenceShift, describe_shifts};

/// Stored data of an unfinished run.
#[derive(Debug, Clone)]
pub struct InterruptedRun {
    /// Stages in the order in which they were started.
    pub started_stages: Vec<Stage>,
    pub readings: Vec<Reading>,
    /// Answered prompts as (step id, repeat number).
    pub answered_prompt_steps_and_repeats: Vec<(u32, u32)>,
    /// Wall time since the last reading, s.
    pub time_since_last_reading_s: f64,
}

/// Whether a run can be resumed after a stop: its references were measured in all reference directions.
pub fn can_resume(plan: &Plan, readings: &[Reading]) -> bool {
    ReferencePoints::from_readings(plan, readings).covers_all_reference_directions()
}

impl Run<'_> {
    /// See [`can_resume`].
    pub fn can_resume(&self) -> bool {
        can_resume(&self.plan, &self.readings)
    }

    /// Continues the run where it was interrupted. Before the call, `self.plan` must hold the steps so far, and the
    /// operator's acknowledgement must be in the journal.
    ///
    /// # Errors
    /// The errors of [`Run::execute`]; after [`RunError::ReferencesShifted`] and
    /// [`RunError::ReferencesIncompleteBeforeStop`] the run is closed.
    pub async fn resume(&mut self, interrupted: InterruptedRun) -> Result<(), RunError> {
        self.is_resumed = true;
        let ended = self.resume_measurement(interrupted).await;
        self.record_end(ended).await
    }

    async fn resume_measurement(&mut self, interrupted: InterruptedRun) -> Result<(), RunError> {
        let stages = interrupted.started_stages;
        self.readings = interrupted.readings;
        self.answered_prompt_steps_and_repeats = interrupted.answered_prompt_steps_and_repeats;
        // With several sensors, the sample stored last is not always the latest in time.
        let last_s = self.readings.iter().map(|reading| reading.t_s).max_by(f64::total_cmp);
        let Some(gap_s) = last_s.filter(|_| self.can_resume()) else {
            return Err(RunError::ReferencesIncompleteBeforeStop);
        };
        self.check_positions_available_in_motion(&self.plan.steps)?;
        for stage in &stages {
            self.check_operator_available(self.open_prompts(stage)?.first().map(|asked| asked.text.as_str()))?;
        }
        self.rehearse().await?;
        stages.iter().for_each(|stage| self.remaining_stages.remove_up_to_begun_stage(&stage.name));
        let machine_position = self.prepare_devices().await?;
        self.journal.set_state(self.id, RunState::Running).await?;
        // Journaled before the first touch: all later readings come after the gap.
        self.record_event(RunEvent::Resumed { gap_s }).await?;
        if self.plan.interruption_times_s.last() != Some(&gap_s) {
            self.plan.interruption_times_s.push(gap_s);
        }
        self.timeline = Timeline::resumed_after(gap_s, interrupted.time_since_last_reading_s);
        let machine_position = if self.was_artefact_remounted() {
            let text = "the artefact was remounted after the last reading: the references cannot be compared";
            self.record_event(RunEvent::OperatorMessage { text: text.to_owned() }).await?;
            Some(machine_position)
        } else {
            self.measure_references(&stages, machine_position).await?
        };
        let (done, machine_position) = self.finish_stage(stages, machine_position).await?;
        self.run_stages(done, machine_position).await
    }

    /// Whether a person has turned the artefact on its stage since the last reading.
    fn was_artefact_remounted(&self) -> bool {
        let last_read = self.readings.iter().map(|reading| reading.step).max();
        let is_mount = |id: u32| self.plan.steps.iter().any(|step| step.id == id && step.mount.is_some());
        self.answered_prompt_steps_and_repeats.iter().any(|(id, _)| Some(*id) > last_read && is_mount(*id))
    }

    /// Measures the references again; no other motion follows unless all of them agree.
    async fn measure_references(
        &mut self,
        stages: &[Stage],
        machine_position: Position,
    ) -> Result<Option<Position>, RunError> {
        let count = self.readings.len();
        let (mut stages, mut machine_position) = (stages.to_vec(), Some(machine_position));
        for _ in 0..ReferencePoints::from_readings(&self.plan, &self.readings).repeats_after_stop() {
            let stage =
                ReferencePoints::from_readings(&self.plan, &self.readings[..count]).reference_repeat_stage(&stages);
            self.journal.add_stage(self.id, &stage, &[]).await?;
            self.record_event(RunEvent::StageStarted { stage: stage.clone() }).await?;
            machine_position = self.run_stage(&stages, &stage, machine_position).await?;
            stages.push(stage);
        }
        let (before, after) = self.readings.split_at(count);
        let references = ReferencePoints::from_readings(&self.plan, before);
        let unseen = references.labels_without_reading(after);
        if !unseen.is_empty() {
            return Err(RunError::ReferencesNotRemeasured { reference_labels: unseen.join("; ") });
        }
        let (mut shifts, scatter) = references.shifts_and_scatter_after_stop(after);
        if shifts.iter().all(ReferenceShift::is_within_limit) {
            let text = format!("the references agree: {}", describe_shifts(&shifts));
            self.record_event(RunEvent::OperatorMessage { text }).await?;
            return Ok(machine_position);
        }
        shifts.retain(|shift| !shift.is_within_limit());
        Err(RunError::ReferencesShifted { shifts, scatter })
    }

    /// Measures the rest of the interrupted stage. Returns the method's stages so far, all done.
    async fn finish_stage(
        &mut self,
        mut stages: Vec<Stage>,
        machine_position: Option<Position>,
    ) -> Result<(Vec<Stage>, Option<Position>), RunError> {
        stages.retain(|stage| stage.repeat < FIRST_REPEAT_NUMBER_AFTER_STOP);
        let Some(mut rest) = stages.last().cloned() else { return Ok((stages, machine_position)) };
        let repeat = rest.repeat;
        let is_read = |step: &u32| self.readings.iter().any(|r| (r.step, r.repeat) == (*step, repeat));
        let is_answered = |step: &u32| self.answered_prompt_steps_and_repeats.contains(&(*step, repeat));
        rest.steps.retain(|step| !is_read(step) && !is_answered(step));
        if rest.steps.is_empty() {
            return Ok((stages, machine_position));
        }
        self.record_event(RunEvent::StageStarted { stage: rest.clone() }).await?;
        let machine_position = self.run_stage(&stages, &rest, machine_position).await?;
        Ok((stages, machine_position))
    }
}
