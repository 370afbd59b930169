//! Resuming a stored run after a stop, up to its estimate. Used by the command line and by the service.

use std::sync::Arc;

use jiff::Timestamp;

use super::identify::stored_setup;
use super::prompts::answered;
use super::{CycleError, Interrupted, PromptAnswers, Run, can_resume, conclude};
use crate::archive::story;
use crate::setup::{Devices, MachineFile, RunHistory, SetupError};
use crate::store::{Journal, RunId, RunState, StoredRun};
use machine::record::estimate::Estimate;
use machine::record::event::Event;
use machine::record::plan::ArtefactMount;
use methods::Method;

/// An unfinished run with the machine file and the method with which it was started.
pub struct ResumableRun {
    pub machine: MachineFile,
    method: Arc<dyn Method>,
    stored: StoredRun,
    /// Answered prompts as (step, repeat), and the mountings of the artefact that they confirm.
    answered: Vec<(u32, u32)>,
    mounts: Vec<ArtefactMount>,
    /// Wall time since the last reading, s.
    elapsed_s: f64,
}

/// Question to the operator before the machine moves again.
#[derive(Debug, Clone, PartialEq)]
pub struct Question {
    pub run: RunId,
    /// How the run was interrupted.
    pub ended: String,
    pub ask: &'static str,
    /// Whether the control may have lost its position, so that all axes must be homed first.
    pub position_lost: bool,
}

/// Reason why a run cannot be resumed.
#[derive(Debug, thiserror::Error)]
pub enum AgainError {
    #[error("run {run} {why}: there is nothing to resume")]
    NotUnfinished { run: RunId, why: &'static str, way_on: Option<String> },
    #[error("{}\nnobody has acknowledged it; nothing has moved", .0.ended)]
    Nobody(Question),
    #[error("{}\nnobody has said that all axes are homed; nothing has moved", .0.ended)]
    NotHomed(Question),
    #[error(transparent)]
    Setup(#[from] SetupError),
}

impl ResumableRun {
    /// # Errors
    /// The run is not unfinished, or its machine file or its settings belong to another version.
    pub fn of(stored: StoredRun) -> Result<Self, AgainError> {
        check_state(&stored)?;
        let (machine, method) = stored_setup(&stored)?;
        let since = stored.measured_until.or(stored.summary.ended);
        let elapsed_s =
            since.map_or(0.0, |since| Timestamp::now().duration_since(since).as_secs_f64());
        let answered = answered(&stored.events);
        let mount = |(id, _): &(u32, u32)| stored.plan.steps.iter().find(|s| s.id == *id)?.mount;
        let mounts = answered.iter().filter_map(mount).collect();
        Ok(Self { machine, method, stored, answered, mounts, elapsed_s })
    }

    pub fn stored(&self) -> &StoredRun {
        &self.stored
    }

    pub fn question(&self) -> Question {
        question(&self.stored)
    }

    /// State from which a simulated machine continues.
    pub fn past(&self) -> RunHistory<'_> {
        let Self { stored, mounts, elapsed_s, .. } = self;
        RunHistory { readings: &stored.readings, mounts, elapsed_s: *elapsed_s }
    }

    /// The operator's acknowledgement that the machine may move. It is journaled before any motion.
    ///
    /// # Errors
    /// `who` is empty, or `homed` is false although the control may have lost its position.
    pub fn acknowledged(&self, who: &str, homed: bool) -> Result<Event, AgainError> {
        let question = self.question();
        let who = who.trim().to_owned();
        match (who.is_empty(), question.position_lost && !homed) {
            (true, _) => Err(AgainError::Nobody(question)),
            (false, true) => Err(AgainError::NotHomed(question)),
            (false, false) => {
                let Question { ended, ask, .. } = question;
                let what = format!("{ended}; asked: {ask}");
                Ok(Event::Acknowledged { who, what, leaves: false })
            }
        }
    }

    /// Resumes the run on open devices and returns its estimate. The acknowledgement must be in the journal.
    ///
    /// # Errors
    /// A fault or a stop: the machine holds, and all readings so far are in the journal.
    pub async fn run(
        self,
        devices: &Devices,
        journal: &Journal,
        answers: PromptAnswers,
        tell: &mut dyn FnMut(&Event),
    ) -> Result<(RunId, Estimate), CycleError> {
        let Self { machine, method, stored, answered, elapsed_s, .. } = self;
        let StoredRun { summary, plan, stages, readings, .. } = stored;
        let run = Run::new(summary.id, method.as_ref(), devices, journal, plan, tell);
        let mut run = run.asking(answers);
        let ended = run.resume(Interrupted { stages, readings, answered, elapsed_s }).await;
        let estimate = conclude(run, ended, &method, &machine.tolerance).await?;
        Ok((summary.id, estimate))
    }
}

/// Question for an interrupted run.
pub fn question(stored: &StoredRun) -> Question {
    let position_lost = story::position_lost(stored);
    let ask = match position_lost {
        true => {
            "are all axes homed, for the control may have lost its position? does each axis without a homing \
             switch stand at its zero mark when the control shows 0? is the way free, what sits in the spindle \
             whole?"
        }
        false => "is the way free, what sits in the spindle whole?",
    };
    Question { run: stored.summary.id, ended: story::how_it_ended(stored), ask, position_lost }
}

fn check_state(stored: &StoredRun) -> Result<(), AgainError> {
    let (run, state) = (stored.summary.id, stored.summary.state);
    if state.is_resumable() {
        return Ok(());
    }
    let why = match state {
        RunState::Finished => "has come to its end",
        RunState::NotIdentified => "was measured to its end and is not identified",
        RunState::Failed => "was refused before anything moved",
        RunState::Closed => "is closed",
        _ => "is under way",
    };
    let way_on = story::next_action(stored, can_resume(&stored.plan, &stored.readings));
    Err(AgainError::NotUnfinished { run, why, way_on })
}
