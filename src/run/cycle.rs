//! One cycle to its end: measure, identify beside the runtime, judge, store.

use std::sync::Arc;

use jiff::Timestamp;

use super::identify::{Unidentified, identify, judged, store_identification};
use super::qualified::{Unqualified, qualified};
use super::{Answers, Run, RunError};
use crate::setup::{Devices, MachineFile};
use crate::store::{Journal, NewRun, RunId, StoreError};
use machine::record::estimate::{Estimate, Limit};
use machine::record::event::Event;
use machine::record::plan::Plan;
use methods::Method;

/// How a cycle can end without an estimate.
#[derive(Debug, thiserror::Error)]
pub enum CycleError {
    /// The measurement did not come to its end. `moved`: the machine stands on the way; `resumed`: it
    /// was interrupted before; `can_resume`: its references were measured.
    #[error("{error}")]
    Run { run: RunId, error: RunError, moved: bool, resumed: bool, can_resume: bool },
    /// Everything is measured and kept.
    #[error("{why}")]
    Identification { run: RunId, why: Unidentified },
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The probe is not qualified as the run needs it. Nothing has begun.
    #[error(transparent)]
    Unqualified(#[from] Unqualified),
}

impl CycleError {
    /// The machine stands where it was stopped, and a person decides.
    pub fn holds(&self) -> bool {
        match self {
            Self::Run { error, moved, resumed, .. } => {
                !error.closes() && (*moved || *resumed || error.is_stop())
            }
            // After the last reading nothing moves.
            Self::Identification { .. } | Self::Store(_) | Self::Unqualified(_) => false,
        }
    }

    /// A person asked for it.
    pub fn is_stop(&self) -> bool {
        match self {
            Self::Run { error, .. } => error.is_stop(),
            Self::Identification { why, .. } => matches!(why, Unidentified::Stopped),
            Self::Store(_) | Self::Unqualified(_) => false,
        }
    }
}

/// What is to be measured.
pub struct Cycle<'a> {
    pub machine: &'a MachineFile,
    pub method: Arc<dyn Method>,
    /// With what is known already, without steps.
    pub plan: Plan,
    /// Whoever is there to be asked.
    pub answers: Answers,
}

impl Cycle<'_> {
    /// A new run on open devices; `begun` hears its number.
    ///
    /// # Errors
    /// A fault or a stop: the machine holds, what was measured is in the journal. A probe that is not qualified.
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

/// Identifies, judges and stores what a run has measured that came to its end. Without an estimate the run is
/// `not identified`.
///
/// # Errors
/// How the run `ended`; or why it is not identified.
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
