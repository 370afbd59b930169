//! One complete cycle: measure, identify on a separate thread, judge, store.

use std::sync::Arc;

use jiff::Timestamp;

use super::identify::{Unidentified, identify, judged, store_identification};
use super::qualified::{Unqualified, qualified};
use super::{PromptAnswers, Run, RunError};
use crate::setup::{Devices, MachineFile};
use crate::store::{Journal, NewRun, RunId, StoreError};
use machine::record::estimate::{Estimate, Limit};
use machine::record::event::Event;
use machine::record::plan::Plan;
use methods::Method;

/// Reason why a cycle ends without an estimate.
#[derive(Debug, thiserror::Error)]
pub enum CycleError {
    /// The measurement is incomplete. `moved`: the machine has moved; `resumed`: the run was interrupted
    /// before; `can_resume`: its references were measured.
    #[error("{error}")]
    Run { run: RunId, error: RunError, moved: bool, resumed: bool, can_resume: bool },
    /// All readings are measured and stored.
    #[error("{why}")]
    Identification { run: RunId, why: Unidentified },
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The probe lacks the qualification that the run requires. The run has not begun.
    #[error(transparent)]
    Unqualified(#[from] Unqualified),
}

impl CycleError {
    /// Whether the machine holds where it was stopped until an operator decides.
    pub fn holds(&self) -> bool {
        match self {
            Self::Run { error, moved, resumed, .. } => {
                !error.closes() && (*moved || *resumed || error.is_stop())
            }
            // No motion follows the last reading.
            Self::Identification { .. } | Self::Store(_) | Self::Unqualified(_) => false,
        }
    }

    /// Whether a person requested the stop.
    pub fn is_stop(&self) -> bool {
        match self {
            Self::Run { error, .. } => error.is_stop(),
            Self::Identification { why, .. } => matches!(why, Unidentified::Stopped),
            Self::Store(_) | Self::Unqualified(_) => false,
        }
    }
}

/// Input of a measurement cycle.
pub struct Cycle<'a> {
    pub machine: &'a MachineFile,
    pub method: Arc<dyn Method>,
    /// Plan with machine, probe and priors, but without steps.
    pub plan: Plan,
    /// Source of the answers to prompts.
    pub answers: PromptAnswers,
}

impl Cycle<'_> {
    /// Starts a new run on open devices; `begun` is called with its number.
    ///
    /// # Errors
    /// A fault or a stop: the machine holds, and all readings so far are in the journal. A probe without the
    /// required qualification.
    pub async fn run(
        self,
        devices: &Devices,
        journal: &Journal,
        begun: impl FnOnce(RunId),
        tell: &mut dyn FnMut(&Event),
    ) -> Result<(RunId, Estimate), CycleError> {
        let Self { machine, method, plan, answers } = self;
        let plan = qualified(method.as_ref(), plan, journal, Timestamp::now())?;
        let new = NewRun { config: machine.text().to_owned(), plan: plan.clone() };
        let id = journal.begin(&new).await?;
        begun(id);
        let run = Run::new(id, method.as_ref(), devices, journal, plan, tell);
        let mut run = run.asking(answers);
        let ended = run.execute().await;
        let estimate = conclude(run, ended, &method, &machine.tolerance).await?;
        Ok((id, estimate))
    }
}

/// Identifies, judges and stores a run that was measured to its end. Without an estimate the state of the run
/// is `not identified`.
///
/// # Errors
/// The error in `ended`, or the reason why the run is not identified.
pub async fn conclude(
    run: Run<'_>,
    ended: Result<(), RunError>,
    method: &Arc<dyn Method>,
    tolerance: &[Limit],
) -> Result<Estimate, CycleError> {
    let can_resume = run.can_resume();
    let Run { id, plan, readings, moved, resumed, tell, journal, devices, .. } = run;
    if let Err(error) = ended {
        return Err(CycleError::Run { run: id, error, moved, resumed, can_resume });
    }
    let text = format!("identifying from {} readings", readings.len());
    tell(&Event::Announced { text });
    let found = identify(method, plan, readings, &devices.controller.halt()).await;
    let found = found.map(|estimate| judged(estimate, tolerance));
    let stored = store_identification(journal, id, found).await;
    stored.map_err(|why| CycleError::Identification { run: id, why })
}
