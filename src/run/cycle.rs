//! One complete cycle: measure, identify on a separate thread, judge, store.

use std::sync::Arc;

use jiff::Timestamp;

use super::identify::{IdentificationError, identify_and_judge_until_halted, store_identification};
use super::qualification::{QualificationError, add_qualification};
use super::{PromptAnswerSource, Run, RunError};
use crate::setup::{Devices, MachineFile};
use crate::store::{Journal, NewRun, RunId, StoreError};
use machine::record::estimate::{Estimate, ParameterTolerance};
use machine::record::event::RunEvent;
use machine::record::plan::Plan;
use methods::Method;

/// Reason why a cycle ends without an estimate.
#[derive(Debug, thiserror::Error)]
pub enum CycleError {
    /// The measurement is incomplete. `may_have_moved`: the machine may have moved since the start or the resume;
    /// `is_resumed`: the run was interrupted before; `can_resume`: its references were measured.
    #[error("{error}")]
    MeasurementIncomplete { run: RunId, error: RunError, may_have_moved: bool, is_resumed: bool, can_resume: bool },
    /// All readings are measured and stored.
    #[error("{why}")]
    NotIdentified { run: RunId, why: IdentificationError },
    /// The run could not be added to the journal. The run has not begun.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The probe lacks the qualification that the run requires. The run has not begun.
    #[error(transparent)]
    Qualification(#[from] QualificationError),
}

impl CycleError {
    /// Whether the machine holds where it was stopped until an operator decides; false if the error closes the run, or
    /// if a new run ends before its first step without a requested stop.
    pub fn holds_machine(&self) -> bool {
        match self {
            CycleError::MeasurementIncomplete { error, may_have_moved, is_resumed, .. } => {
                !error.closes_run() && (*may_have_moved || *is_resumed || error.is_requested_stop())
            }
            // No motion follows the last reading.
            CycleError::NotIdentified { .. } | Self::Store(_) | Self::Qualification(_) => false,
        }
    }

    /// Whether a person requested the stop.
    pub fn is_requested_stop(&self) -> bool {
        match self {
            CycleError::MeasurementIncomplete { error, .. } => error.is_requested_stop(),
            CycleError::NotIdentified { why, .. } => matches!(why, IdentificationError::Stopped),
            Self::Store(_) | Self::Qualification(_) => false,
        }
    }
}

/// Input of a measurement cycle.
pub struct Cycle<'a> {
    pub machine_file: &'a MachineFile,
    pub method: Arc<dyn Method>,
    /// Plan with machine, probe and priors, but without steps.
    pub plan_without_steps: Plan,
    /// Source of the answers to prompts.
    pub prompt_answer_source: PromptAnswerSource,
}

impl Cycle<'_> {
    /// Starts a new run on open devices; `on_start` is called with its number.
    ///
    /// # Errors
    /// A fault or a stop: the machine holds, and all readings so far are in the journal. A probe without the
    /// required qualification.
    pub async fn run(
        self,
        devices: &Devices,
        journal: &Journal,
        on_start: impl FnOnce(RunId),
        on_event: &mut dyn FnMut(&RunEvent),
    ) -> Result<(RunId, Estimate), CycleError> {
        let Self { machine_file: machine, method, plan_without_steps: plan, prompt_answer_source: answers } = self;
        let plan = add_qualification(method.as_ref(), plan, journal, Timestamp::now())?;
        let new = NewRun { machine_file_text: machine.text().to_owned(), plan: plan.clone() };
        let id = journal.begin_run(&new).await?;
        on_start(id);
        let run = Run::new(id, method.as_ref(), devices, journal, plan, on_event);
        let mut run = run.with_prompt_answer_source(answers);
        let ended = match run.record_compensation_values(machine).await {
            Ok(()) => run.execute().await,
            Err(error) => Err(error),
        };
        let estimate = identify_judge_and_store(run, ended, &method, &machine.tolerances).await?;
        Ok((id, estimate))
    }
}

/// Identifies, judges and stores a run that was measured to its end. Without an estimate the state of the run
/// is `not identified`.
///
/// # Errors
/// The error in `run_result`, or the reason why the run is not identified.
pub async fn identify_judge_and_store(
    run: Run<'_>,
    run_result: Result<(), RunError>,
    method: &Arc<dyn Method>,
    tolerances: &[ParameterTolerance],
) -> Result<Estimate, CycleError> {
    let can_resume = run.can_resume();
    let Run { id, plan, readings, may_have_moved, is_resumed, on_event, journal, devices, .. } = run;
    if let Err(error) = run_result {
        return Err(CycleError::MeasurementIncomplete { run: id, error, may_have_moved, is_resumed, can_resume });
    }
    let text = format!("computing the estimate from {} readings", readings.len());
    on_event(&RunEvent::OperatorMessage { text });
    let halt = devices.open_controller.halt_handle();
    let found = identify_and_judge_until_halted(method, plan, readings, tolerances, &halt).await;
    let stored = store_identification(journal, id, found).await;
    stored.map_err(|why| CycleError::NotIdentified { run: id, why })
}
