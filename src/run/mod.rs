//! State machine of one run and sole owner of the devices. It requests the next stage from the method, proves
//! every block of the stage before the first motion, executes step by step, and makes each reading durable
//! before the next touch.
//!
//! After a fault or a stop the machine holds; this module does not move it again.

mod again;
mod counted_turn;
mod cycle;
mod display_rounding;
mod equal_angles;
mod error;
mod identify;
mod live_check;
mod live_values;
#[cfg(test)]
mod live_values_tests;
mod priority;
mod prompts;
mod qualified;
mod remaining_stages;
mod resume;
mod scan;
mod scan_in_motion;
mod stage;
mod sweep;
mod temperature;
#[cfg(test)]
mod tests;
mod timeline;
mod watched_sensors;

pub use again::{AgainError, Question, ResumableRun, question};
pub use cycle::{Cycle, CycleError, conclude};
pub use error::RunError;
pub use identify::{
    Unidentified, identified, identify_stored, judged, start_identification, store_identification,
};
pub use priority::{HTTP_NICE, lower_priority};
pub use prompts::{Asked, PromptAnswers};
pub use qualified::{Unqualified, check_probe};
pub use resume::{Interrupted, can_resume};
pub use stage::{Rehearsed, rehearse};

use self::prompts::first_question;
use self::remaining_stages::Ahead;
use self::temperature::TemperatureLog;
use self::timeline::Timeline;
use crate::setup::{Devices, Mounted};
use crate::store::{Journal, RunId, RunState};
use devices::controllers::describe_not_readable;
use machine::Position;
use machine::record::event::Event;
use machine::record::plan::{Plan, Stage, Step};
use machine::record::reading::Reading;
use methods::{Method, Next, Source};
use planning::Confirmed;
use planning::gcode::Transmission;

/// One run of one method.
pub struct Run<'a> {
    pub id: RunId,
    pub method: &'a dyn Method,
    pub devices: &'a Devices,
    pub journal: &'a Journal,
    /// Plan so far; each stage adds its steps.
    pub plan: Plan,
    pub readings: Vec<Reading>,
    /// Whether any block was sent that moves the machine.
    pub moved: bool,
    /// Whether the run was resumed after an interruption.
    pub resumed: bool,
    /// Directions that touches have confirmed since the control was prepared.
    confirmed: Confirmed,
    /// How the control receives blocks; valid after it was prepared.
    transmission: Transmission,
    timeline: Timeline,
    /// Open sensors of the plan.
    looking: Vec<Mounted>,
    /// Source of the answers to prompts, and the answered prompts as (step, repeat).
    answers: PromptAnswers,
    answered: Vec<(u32, u32)>,
    warmth: TemperatureLog,
    ahead: Ahead,
    /// Whether the operator, a touch or a sensor has shown since the last preparation that the probe works.
    probe_lives: bool,
    /// Called with each event after it is durable.
    tell: &'a mut dyn FnMut(&Event),
}

impl<'a> Run<'a> {
    /// A run with the number `id` in the journal; its plan has no steps yet.
    pub fn new(
        id: RunId,
        method: &'a dyn Method,
        devices: &'a Devices,
        journal: &'a Journal,
        plan: Plan,
        tell: &'a mut dyn FnMut(&Event),
    ) -> Self {
        Self {
            id,
            method,
            devices,
            journal,
            plan,
            readings: Vec::new(),
            moved: false,
            resumed: false,
            confirmed: Confirmed::default(),
            transmission: Transmission::Rows,
            timeline: Timeline::new(),
            looking: Vec::new(),
            answers: PromptAnswers::nobody(),
            answered: Vec::new(),
            warmth: TemperatureLog::default(),
            ahead: Ahead::default(),
            probe_lives: false,
            tell,
        }
    }

    /// Sets the source of the answers to prompts.
    pub fn asking(self, answers: PromptAnswers) -> Self {
        Self { answers, ..self }
    }

    /// Measures the whole run. The plan and the readings stay in `self` after an error.
    ///
    /// # Errors
    /// A fault or a stop: the machine holds, and the state in the journal is `held` (a stop, or a fault after
    /// the first motion), `failed` (refused before the first motion) or `closed` (not resumable).
    pub async fn execute(&mut self) -> Result<(), RunError> {
        let ended = self.measure().await;
        self.end(ended).await
    }

    /// Journals the end of the run.
    async fn end(&mut self, ended: Result<(), RunError>) -> Result<(), RunError> {
        match ended {
            Ok(()) => {
                self.journal.set_state(self.id, RunState::NotIdentified).await?;
                self.note(Event::Finished).await
            }
            Err(error) => {
                let error = match self.plan.sensors.first() {
                    Some(sensor) => error.of_sensor(&sensor.name),
                    None if self.probe_lives => error,
                    None => error.of_first_touch(),
                };
                self.keep(&error).await;
                Err(error)
            }
        }
    }

    async fn measure(&mut self) -> Result<(), RunError> {
        let steps = self.rehearse().await?;
        self.can_sweep(&steps)?;
        self.can_ask(first_question(&steps))?;
        // The method refuses a plan before the first motion.
        self.next(&[])?;
        let planned = Plan { steps, ..self.plan.clone() };
        for text in self.method.forecast(&planned, self.ahead.machine_s())? {
            self.note(Event::Announced { text }).await?;
        }
        let stands = self.prepare().await?;
        self.stages(Vec::new(), Some(stands)).await
    }

    /// Rehearses the run from nominal positions: stores the remaining stages and returns their steps.
    async fn rehearse(&mut self) -> Result<Vec<Step>, RunError> {
        let (ahead, steps) =
            stage::rehearsed(self.method, &self.plan, &self.devices.dialect).await?;
        self.ahead = ahead;
        Ok(steps)
    }

    /// Prepares control and thermometers; returns the position of the machine.
    async fn prepare(&mut self) -> Result<Position, RunError> {
        let prepared = self.devices.controller.prepare().await?;
        let text = format!("{}; {}", prepared.identity, prepared.stop);
        self.note(Event::Announced { text }).await?;
        if let Some(text) = describe_not_readable(&prepared.not_readable) {
            self.note(Event::Announced { text }).await?;
        }
        self.warmth.begin(&self.devices.thermometers).await;
        self.confirmed = Confirmed::default();
        self.transmission = prepared.transmission;
        if !self.plan.sensors.is_empty() {
            self.sensors_live().await?;
            return Ok(prepared.stands);
        }
        Ok(self.live_check().await?.unwrap_or(prepared.stands))
    }

    /// Runs all stages after the `done` ones.
    async fn stages(
        &mut self,
        mut done: Vec<Stage>,
        mut stands: Option<Position>,
    ) -> Result<(), RunError> {
        let mut next = self.next(&done)?;
        while let Next::Stage { stage, new_steps } = next {
            self.plan.steps.extend(new_steps.iter().cloned());
            self.journal.stage(self.id, &stage, &new_steps).await?;
            self.note(Event::StageStarted { stage: stage.clone() }).await?;
            self.ahead.begin(&stage.name);
            stands = self.run_stage(&done, &stage, stands).await?;
            done.push(stage);
            next = self.next(&done)?;
        }
        self.tell_of_samples().await?;
        self.tell_of_thermometers().await?;
        Ok(self.devices.controller.finish().await?)
    }

    /// Reports for each sensor how many samples came and how many were ignored.
    async fn tell_of_samples(&mut self) -> Result<(), RunError> {
        let mut told = Vec::new();
        for sensor in &self.looking {
            // A sensor that has failed since then was reported where it was needed.
            let tally = sensor.tally().await.unwrap_or_default();
            told.extend((tally.came > 0).then(|| format!("{}: {tally}", sensor.name())));
        }
        for text in told {
            self.note(Event::Announced { text }).await?;
        }
        Ok(())
    }

    fn next(&self, done: &[Stage]) -> Result<Next, RunError> {
        Ok(self.method.next(&self.plan, done, Source::Measured(&self.readings))?)
    }

    /// Journals the event, then reports it.
    async fn note(&mut self, event: Event) -> Result<(), RunError> {
        self.journal.event(self.id, &event).await?;
        (self.tell)(&event);
        Ok(())
    }

    /// Journals how the run ended. If the journal itself has failed, its own error is reported instead, and
    /// there is nowhere to write.
    async fn keep(&mut self, error: &RunError) {
        let event = match error {
            _ if error.is_stop() => Event::Held { reason: error.to_string() },
            _ => Event::Faulted {
                what: error.to_string(),
                remedy: error.remedy(),
                position_lost: error.position_lost(),
            },
        };
        let state = match error {
            _ if error.closes() => RunState::Closed,
            _ if self.moved || self.resumed || error.is_stop() => RunState::Held,
            _ => RunState::Failed,
        };
        drop(self.journal.event(self.id, &event).await);
        drop(self.journal.set_state(self.id, state).await);
        (self.tell)(&event);
    }
}
