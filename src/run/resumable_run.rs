//! Resuming a stored run after a stop, up to its estimate. Used by the command line and by the service.

use std::sync::Arc;

use jiff::Timestamp;

use super::identify::setup_of_stored_run;
use super::prompts::answered_prompt_steps_and_repeats;
use super::{CycleError, InterruptedRun, PromptAnswerSource, Run, can_resume, identify_judge_and_store};
use crate::archive::run_story;
use crate::setup::{Devices, EarlierSessions, MachineFile, SetupError};
use crate::store::{Journal, RunId, RunState, StoredRun};
use machine::record::estimate::Estimate;
use machine::record::event::RunEvent;
use machine::record::plan::ArtefactMount;
use methods::Method;

/// An unfinished run with the machine file and the method with which it was started.
pub struct ResumableRun {
    pub machine_file: MachineFile,
    pub stored_run: StoredRun,
    method: Arc<dyn Method>,
    /// Answered prompts as (step id, repeat number).
    answered_prompt_steps_and_repeats: Vec<(u32, u32)>,
    /// Mountings of the artefact that the answered prompts confirm.
    confirmed_mountings: Vec<ArtefactMount>,
    /// Wall time since the last reading, s; without a reading, since the end of the run.
    time_since_last_reading_s: f64,
}

/// Question to the operator before the machine moves again.
#[derive(Debug, Clone, PartialEq)]
pub struct ResumeQuestion {
    pub run: RunId,
    /// How the run was interrupted.
    pub end_reason: String,
    pub question_text: &'static str,
    /// Whether the control may have lost its position, so that all axes must be homed first.
    pub may_have_lost_position: bool,
}

/// Reason why a run cannot be resumed.
#[derive(Debug, thiserror::Error)]
pub enum ResumeRefusal {
    #[error("run {run} {why} and cannot be resumed")]
    NotResumable { run: RunId, why: &'static str, next_action: Option<String> },
    #[error("{}\nthe name of the operator who has checked the machine is missing; nothing has moved", .0.end_reason)]
    OperatorNameMissing(ResumeQuestion),
    #[error("{}\nthe confirmation that all axes are homed is missing; nothing has moved", .0.end_reason)]
    HomingNotConfirmed(ResumeQuestion),
    #[error(transparent)]
    Setup(#[from] SetupError),
}

impl ResumableRun {
    /// # Errors
    /// The run is not in a resumable state, or its machine file or settings belong to another program version.
    pub fn from_stored(stored: StoredRun) -> Result<Self, ResumeRefusal> {
        check_is_resumable(&stored)?;
        let (machine_file, method) = setup_of_stored_run(&stored)?;
        let since = stored.last_reading_stored_at.or(stored.summary.ended);
        let elapsed_s = since.map_or(0.0, |since| Timestamp::now().duration_since(since).as_secs_f64());
        let answered_prompts = answered_prompt_steps_and_repeats(&stored.events);
        let mount = |(id, _): &(u32, u32)| stored.plan.steps.iter().find(|s| s.id == *id)?.mount;
        let mountings = answered_prompts.iter().filter_map(mount).collect();
        Ok(Self {
            machine_file,
            stored_run: stored,
            method,
            answered_prompt_steps_and_repeats: answered_prompts,
            confirmed_mountings: mountings,
            time_since_last_reading_s: elapsed_s,
        })
    }

    /// Readings and mountings so far, from which a simulated machine continues.
    pub fn earlier_sessions(&self) -> EarlierSessions<'_> {
        let Self { stored_run: stored, confirmed_mountings: mountings, time_since_last_reading_s: elapsed_s, .. } =
            self;
        EarlierSessions { readings: &stored.readings, mountings, time_since_last_reading_s: *elapsed_s }
    }

    /// The operator's acknowledgement that the machine may move. It is journaled before any motion.
    ///
    /// # Errors
    /// `who` is empty, or `is_homing_confirmed` is false although the control may have lost its position.
    pub fn acknowledgement_event(&self, who: &str, is_homing_confirmed: bool) -> Result<RunEvent, ResumeRefusal> {
        let question = resume_question(&self.stored_run);
        let who = who.trim().to_owned();
        match (who.is_empty(), question.may_have_lost_position && !is_homing_confirmed) {
            (true, _) => Err(ResumeRefusal::OperatorNameMissing(question)),
            (false, true) => Err(ResumeRefusal::HomingNotConfirmed(question)),
            (false, false) => {
                let ResumeQuestion { end_reason, question_text: confirmation, .. } = question;
                let what = format!("{end_reason}; confirmed question: {confirmation}");
                Ok(RunEvent::Acknowledged { who, what, leaves: false })
            }
        }
    }

    /// Resumes the run on open devices and returns its estimate. The acknowledgement must be in the journal.
    ///
    /// # Errors
    /// A fault or a stop: the machine holds, and all readings so far are in the journal.
    pub async fn resume_and_identify(
        self,
        devices: &Devices,
        journal: &Journal,
        answers: PromptAnswerSource,
        on_event: &mut dyn FnMut(&RunEvent),
    ) -> Result<(RunId, Estimate), CycleError> {
        let StoredRun { summary, plan, stages, readings, .. } = self.stored_run;
        let run = Run::new(summary.id, self.method.as_ref(), devices, journal, plan, on_event);
        let mut run = run.with_prompt_answer_source(answers);
        let interrupted = InterruptedRun {
            started_stages: stages,
            readings,
            answered_prompt_steps_and_repeats: self.answered_prompt_steps_and_repeats,
            time_since_last_reading_s: self.time_since_last_reading_s,
        };
        let ended = run.resume(interrupted).await;
        let estimate = identify_judge_and_store(run, ended, &self.method, &self.machine_file.tolerances).await?;
        Ok((summary.id, estimate))
    }
}

/// Question to the operator before the interrupted run is resumed.
pub fn resume_question(stored: &StoredRun) -> ResumeQuestion {
    let position_lost = run_story::may_have_lost_position(stored);
    let confirmation = match position_lost {
        true => {
            "Are all axes homed (the control may have lost its position)? Is each axis without a homing \
            switch at its zero mark when the control shows 0? Is the path free, and is the probe or sensor \
            in the spindle undamaged?"
        }
        false => "Is the path free, and is the probe or sensor in the spindle undamaged?",
    };
    ResumeQuestion {
        run: stored.summary.id,
        end_reason: run_story::describe_run_end(stored),
        question_text: confirmation,
        may_have_lost_position: position_lost,
    }
}

fn check_is_resumable(stored: &StoredRun) -> Result<(), ResumeRefusal> {
    let (run, state) = (stored.summary.id, stored.summary.state);
    if state.is_resumable() {
        return Ok(());
    }
    let why = match state {
        RunState::Finished => "is finished",
        RunState::NotIdentified => "is measured completely and has no estimate yet",
        RunState::Failed => "was refused before any motion",
        RunState::NotResumable => "is closed",
        _ => "is in progress",
    };
    let next_action = run_story::next_action(stored, can_resume(&stored.plan, &stored.readings));
    Err(ResumeRefusal::NotResumable { run, why, next_action })
}
