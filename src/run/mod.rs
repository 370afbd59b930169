//! State machine of one run and sole owner of the devices. It requests the next stage from the method, proves
//! every block of the stage before the first motion, executes step by step, and makes each reading durable
//! before the next touch.
//!
//! After a fault or a stop the machine holds; this module does not move it again.

mod combination;
mod counted_turn;
mod cycle;
mod equal_angles;
mod error;
mod identify;
mod live_check;
mod live_values;
#[cfg(test)]
mod live_values_tests;
mod position_assignment;
mod priority;
mod prompts;
mod qualification;
mod remaining_stages;
mod repeatability;
mod resumable_run;
mod resume;
mod scan;
mod scan_in_motion;
mod stage;
mod temperature;
#[cfg(test)]
mod tests;
mod timeline;
mod unrounded_position;
mod watched_sensors;

pub use combination::{CombinationError, combine_stored_runs};
pub use cycle::{Cycle, CycleError, identify_judge_and_store};
pub use error::RunError;
pub use identify::{
    IdentificationError, identify_readings, identify_stored_run, judge_estimate, start_identification,
    store_identification,
};
pub use priority::{HTTP_NICE, lower_priority};
pub use prompts::{OpenPrompt, PromptAnswerSource};
pub use qualification::{QualificationError, check_qualifications_match_probe};
pub use repeatability::{RepeatabilityError, RepeatabilityTable, RepetitionKind, repeatability_of_runs};
pub use resumable_run::{ResumableRun, ResumeQuestion, ResumeRefusal, resume_question};
pub use resume::{InterruptedRun, can_resume};
pub use stage::{RehearsalResult, rehearse};

use std::time::Duration;

use self::prompts::first_prompt_text;
use self::remaining_stages::RemainingStages;
use self::temperature::TemperatureLog;
use self::timeline::Timeline;
use crate::compensation::describe_compensation_values;
use crate::setup::{Devices, MachineFile, OpenSensor};
use crate::store::{Journal, RunId, RunState};
use devices::controllers::describe_unreadable_items;
use machine::Position;
use machine::record::event::RunEvent;
use machine::record::plan::{Plan, Stage, Step};
use machine::record::reading::Reading;
use methods::{Method, NextStage, ObjectPositionSource};
use planning::TouchedDirections;
use planning::gcode::TransmissionForm;

/// Timeout for the compensation values of the control: its computer may be reached over a network.
const COMPENSATION_VALUES_TIMEOUT: Duration = Duration::from_secs(10);

/// One run of one method.
pub struct Run<'a> {
    pub id: RunId,
    pub method: &'a dyn Method,
    pub devices: &'a Devices,
    pub journal: &'a Journal,
    /// Plan so far; each stage adds its steps.
    pub plan: Plan,
    /// All readings so far, also those before an interruption.
    pub readings: Vec<Reading>,
    /// Whether the execution of a step has begun since the start or the resume of the run.
    pub may_have_moved: bool,
    /// Whether the run was resumed after an interruption.
    pub is_resumed: bool,
    /// Directions that touches have confirmed since the control was prepared.
    confirmed_directions: TouchedDirections,
    /// How the control receives blocks; valid after it was prepared.
    transmission: TransmissionForm,
    /// Converts the time of the control to the clock of the run, which continues after an interruption.
    timeline: Timeline,
    /// Open sensors of the plan.
    open_sensors: Vec<OpenSensor>,
    /// Source of the answers to prompts.
    prompt_answer_source: PromptAnswerSource,
    /// Answered prompts as (step id, repeat number).
    answered_prompt_steps_and_repeats: Vec<(u32, u32)>,
    temperature_log: TemperatureLog,
    /// Rehearsed stages that have not begun. They give the remaining machine time only; the method states what is
    /// measured next.
    remaining_stages: RemainingStages,
    /// Whether the operator, a touch or a sensor has shown since the start or the resume that the probe works.
    is_probe_confirmed: bool,
    /// Called with each event; if the journal stores the event, after it is durable.
    on_event: &'a mut dyn FnMut(&RunEvent),
}

impl<'a> Run<'a> {
    /// A run with the number `id` in the journal; the stages add their steps to the plan.
    pub fn new(
        id: RunId,
        method: &'a dyn Method,
        devices: &'a Devices,
        journal: &'a Journal,
        plan_without_steps: Plan,
        on_event: &'a mut dyn FnMut(&RunEvent),
    ) -> Self {
        Self {
            id,
            method,
            devices,
            journal,
            plan: plan_without_steps,
            readings: Vec::new(),
            may_have_moved: false,
            is_resumed: false,
            confirmed_directions: TouchedDirections::default(),
            transmission: TransmissionForm::TableRows,
            timeline: Timeline::new(),
            open_sensors: Vec::new(),
            prompt_answer_source: PromptAnswerSource::without_operator(),
            answered_prompt_steps_and_repeats: Vec::new(),
            temperature_log: TemperatureLog::default(),
            remaining_stages: RemainingStages::default(),
            is_probe_confirmed: false,
            on_event,
        }
    }

    /// Sets the source of the answers to prompts.
    pub fn with_prompt_answer_source(self, answers: PromptAnswerSource) -> Self {
        Self { prompt_answer_source: answers, ..self }
    }

    /// Measures the whole run. The plan and the readings stay in `self` after an error.
    ///
    /// # Errors
    /// A fault or a stop: the machine holds, and the state in the journal is `held` (a stop, or a fault after
    /// the first motion), `failed` (refused before the first motion) or `closed` (not resumable).
    pub async fn execute(&mut self) -> Result<(), RunError> {
        let ended = self.rehearse_and_measure().await;
        self.record_end(ended).await
    }

    /// Journals the end of the run. A complete measurement gets the state `not identified`, until its estimate is
    /// stored.
    async fn record_end(&mut self, run_result: Result<(), RunError>) -> Result<(), RunError> {
        match run_result {
            Ok(()) => {
                self.journal.set_state(self.id, RunState::NotIdentified).await?;
                self.record_event(RunEvent::Finished).await
            }
            Err(error) => {
                let error = match self.plan.sensors.first() {
                    Some(sensor) => error.add_sensor_to_probe_input_error(&sensor.name),
                    None if self.is_probe_confirmed => error,
                    None => error.convert_no_contact_to_no_first_contact(),
                };
                self.journal_error_end(&error).await;
                Err(error)
            }
        }
    }

    /// Measures a new run. The run is rehearsed and all checks without motion are made before the control is
    /// prepared.
    async fn rehearse_and_measure(&mut self) -> Result<(), RunError> {
        let steps = self.rehearse().await?;
        self.check_positions_available_in_motion(&steps)?;
        self.check_operator_available(first_prompt_text(&steps))?;
        // If the method refuses the plan, the run ends before the first motion.
        self.next_stage(&[])?;
        let planned = Plan { steps, ..self.plan.clone() };
        let forecast = self.method.forecast(&planned, self.remaining_stages.total_machine_time_s())?;
        self.record_messages(forecast).await?;
        let position = self.prepare_devices().await?;
        self.run_stages(Vec::new(), Some(position)).await
    }

    /// Rehearses the run from nominal positions: keeps the rehearsed stages in `remaining_stages` and returns all
    /// steps.
    async fn rehearse(&mut self) -> Result<Vec<Step>, RunError> {
        let (remaining, steps) = stage::rehearse_stages(self.method, &self.plan, &self.devices.dialect).await?;
        self.remaining_stages = remaining;
        Ok(steps)
    }

    /// Prepares control, thermometers and the sensors or the probe; returns the position of the machine. Refused while
    /// a compensation of the machine is unfinished.
    async fn prepare_devices(&mut self) -> Result<Position, RunError> {
        if let Some(unfinished) = self.journal.unfinished_compensation(&self.plan.machine.name)? {
            return Err(RunError::UnfinishedCompensation(unfinished));
        }
        let prepared = self.devices.open_controller.prepare().await?;
        // Wrong commands for the tool centre must end the run before its first motion.
        self.devices.open_controller.read_tool_centre().await?;
        self.record_event(RunEvent::ControlPrepared { identity: prepared.identity.to_string() }).await?;
        self.record_event(RunEvent::OperatorMessage { text: prepared.stop_description }).await?;
        self.record_messages(describe_unreadable_items(&prepared.unreadable_items)).await?;
        self.temperature_log.start_polling(&self.devices.thermometers).await;
        self.confirmed_directions = TouchedDirections::default();
        self.transmission = prepared.transmission;
        if !self.plan.sensors.is_empty() {
            self.open_plan_sensors().await?;
            return Ok(prepared.position);
        }
        Ok(self.announce_or_await_probe_check().await?.unwrap_or(prepared.position))
    }

    /// Runs all stages after the `done` ones.
    async fn run_stages(
        &mut self,
        mut done: Vec<Stage>,
        mut machine_position: Option<Position>,
    ) -> Result<(), RunError> {
        let mut next = self.next_stage(&done)?;
        while let NextStage::Stage { stage, new_steps } = next {
            self.plan.steps.extend(new_steps.iter().cloned());
            self.journal.add_stage(self.id, &stage, &new_steps).await?;
            self.record_event(RunEvent::StageStarted { stage: stage.clone() }).await?;
            self.remaining_stages.remove_up_to_begun_stage(&stage.name);
            machine_position = self.run_stage(&done, &stage, machine_position).await?;
            done.push(stage);
            next = self.next_stage(&done)?;
        }
        self.report_sample_counts().await?;
        self.report_missing_temperatures().await?;
        Ok(self.devices.open_controller.restore_modes().await?)
    }

    /// Reports for each sensor how many samples came and how many were ignored.
    async fn report_sample_counts(&mut self) -> Result<(), RunError> {
        let mut messages = Vec::new();
        for sensor in &self.open_sensors {
            // An error is ignored here: the step that needed a failed sensor has reported the failure.
            let tally = sensor.sample_counters().await.unwrap_or_default();
            messages.extend((tally.received_count > 0).then(|| format!("{}: {tally}", sensor.name())));
        }
        self.record_messages(messages).await
    }

    /// Next stage by the method, from the readings so far.
    fn next_stage(&self, done: &[Stage]) -> Result<NextStage, RunError> {
        Ok(self.method.next_stage(&self.plan, done, ObjectPositionSource::Measured(&self.readings))?)
    }

    /// Journals the compensation values that the control holds, and how they differ from the journal.
    async fn record_compensation_values(&mut self, machine: &MachineFile) -> Result<(), RunError> {
        if machine.compensation.is_empty() {
            return Ok(());
        }
        let stored = self.journal.compensations(&machine.machine.name)?;
        let machine = machine.clone();
        let reading = tokio::task::spawn_blocking(move || describe_compensation_values(&machine, &stored));
        let lines = match tokio::time::timeout(COMPENSATION_VALUES_TIMEOUT, reading).await {
            Ok(Ok(lines)) => lines,
            _ => vec!["the compensation values of the control are unknown: the control does not answer".to_owned()],
        };
        self.record_messages(lines).await
    }

    /// Journals and reports each message to the operator.
    async fn record_messages(&mut self, texts: impl IntoIterator<Item = String>) -> Result<(), RunError> {
        for text in texts {
            self.record_event(RunEvent::OperatorMessage { text }).await?;
        }
        Ok(())
    }

    /// Journals the event, then reports it.
    async fn record_event(&mut self, event: RunEvent) -> Result<(), RunError> {
        self.journal.add_event(self.id, &event).await?;
        (self.on_event)(&event);
        Ok(())
    }

    /// Journals the error that ended the run. A failure of the journal is ignored here: the caller reports `error`, and
    /// nothing more can be stored.
    async fn journal_error_end(&mut self, error: &RunError) {
        let event = match error {
            _ if error.is_requested_stop() => RunEvent::Held { reason: error.to_string() },
            _ => RunEvent::Faulted {
                what: error.to_string(),
                remedy: error.remedy(),
                position_lost: error.may_have_lost_position(),
            },
        };
        let state = match error {
            _ if error.closes_run() => RunState::NotResumable,
            _ if self.may_have_moved || self.is_resumed || error.is_requested_stop() => RunState::Held,
            _ => RunState::Failed,
        };
        drop(self.journal.add_event(self.id, &event).await);
        drop(self.journal.set_state(self.id, state).await);
        (self.on_event)(&event);
    }
}
