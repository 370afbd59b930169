//! Floor 7: the state machine of one run. Sole owner of the devices. It asks the method for the
//! next stage, checks every block of it before the first moves, executes step by step, and makes
//! each reading durable before the next touch.
//!
//! After a fault or a stop the machine holds and stays: nothing here moves it again.

mod error;
mod stage;

pub use error::RunError;

use crate::methods::{Method, Next, Source};
use crate::record::event::Event;
use crate::record::plan::{Plan, Stage};
use crate::record::reading::Reading;
use crate::setup::Devices;
use crate::store::{Journal, RunId, RunState};

/// One run of one method.
pub struct Run<'a> {
    pub id: RunId,
    pub method: &'a dyn Method,
    pub devices: &'a Devices,
    pub journal: &'a Journal,
    /// Grows with every stage.
    pub plan: Plan,
    pub readings: Vec<Reading>,
    /// Whether anything was sent that moves the machine.
    pub moved: bool,
    /// Told of everything that happens, after it is durable.
    pub tell: &'a mut dyn FnMut(&Event),
}

impl Run<'_> {
    /// Measure to the end. The plan and the readings stay in `self`, whatever happens.
    ///
    /// # Errors
    /// A fault or a stop: the machine holds, the journal says `held` (a stop, or a fault on the way)
    /// or `failed` (refused before anything moved).
    pub async fn execute(&mut self) -> Result<(), RunError> {
        match self.measure().await {
            Ok(()) => {
                self.journal.set_state(self.id, RunState::Finished).await?;
                self.note(Event::Finished).await
            }
            Err(error) => {
                self.keep(&error).await;
                Err(error)
            }
        }
    }

    async fn measure(&mut self) -> Result<(), RunError> {
        let mut stage_s = self.rehearse().await?.into_iter();
        let first = self.next(&[])?;
        let prepared = self.devices.controller.prepare().await?;
        self.note(Event::Announced { text: format!("{}; {}", prepared.identity, prepared.stop) })
            .await?;
        let mut next = first;
        let mut done: Vec<Stage> = Vec::new();
        let mut stands = Some(prepared.stands);
        while let Next::Stage { stage, new_steps } = next {
            self.plan.steps.extend(new_steps.iter().cloned());
            self.journal.stage(self.id, &stage, &new_steps).await?;
            self.note(Event::StageStarted { stage: stage.clone() }).await?;
            stage_s.next();
            stands = self.run_stage(&done, &stage, stands, stage_s.as_slice().iter().sum()).await?;
            done.push(stage);
            next = self.next(&done)?;
        }
        Ok(self.devices.controller.finish().await?)
    }

    fn next(&self, done: &[Stage]) -> Result<Next, RunError> {
        Ok(self.method.next(&self.plan, done, Source::Measured(&self.readings))?)
    }

    /// Journal, then tell.
    async fn note(&mut self, event: Event) -> Result<(), RunError> {
        self.journal.event(self.id, &event).await?;
        (self.tell)(&event);
        Ok(())
    }

    /// Write down how the run ended. The journal itself may be what failed: then its own fault is
    /// already on its way to the person, and there is nowhere to write.
    async fn keep(&mut self, error: &RunError) {
        let event = match error {
            _ if error.is_stop() => Event::Held { reason: error.to_string() },
            _ => Event::Faulted { what: error.to_string(), remedy: error.remedy() },
        };
        let state = if self.moved || error.is_stop() { RunState::Held } else { RunState::Failed };
        drop(self.journal.event(self.id, &event).await);
        drop(self.journal.set_state(self.id, state).await);
        (self.tell)(&event);
    }
}
