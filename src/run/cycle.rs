//! One cycle to its end: measure, identify beside the runtime, judge, store.

use std::sync::Arc;
use std::time::Duration;

use super::behind::{COMPUTING, behind};
use super::{Answers, Run, RunError};
use crate::setup::{Devices, MachineFile};
use crate::store::{Journal, NewRun, RunId, StoreError};
use devices::controllers::Halt;
use machine::record::estimate::{Estimate, Limit};
use machine::record::event::Event;
use machine::record::plan::Plan;
use machine::record::reading::Reading;
use methods::decision;
use methods::{IdentifyError, Method};

/// How often a stop is looked for while the identification computes.
const STOP_POLL: Duration = Duration::from_millis(50);

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
}

#[derive(Debug, thiserror::Error)]
pub enum Unidentified {
    #[error(transparent)]
    Refused(#[from] IdentifyError),
    #[error("the identification ended without answer")]
    NoAnswer,
    #[error("stopped during the identification")]
    Stopped,
    /// It is found, and found again from the readings.
    #[error("what was found could not be kept: {0}")]
    Unkept(#[from] StoreError),
}

impl CycleError {
    /// The machine stands where it was stopped, and a person decides.
    pub fn holds(&self) -> bool {
        match self {
            Self::Run { error, moved, resumed, .. } => {
                !error.closes() && (*moved || *resumed || error.is_stop())
            }
            Self::Identification { why, .. } => matches!(why, Unidentified::Stopped),
            Self::Store(_) => false,
        }
    }
}

/// What is to be measured, with what is known already.
pub struct Cycle<'a> {
    pub machine: &'a MachineFile,
    pub method: Arc<dyn Method>,
    /// Without steps.
    pub plan: Plan,
    pub priors: Vec<Estimate>,
    /// Whoever is there to be asked.
    pub answers: Answers,
}

impl Cycle<'_> {
    /// A new run on open devices; `begun` hears its number.
    ///
    /// # Errors
    /// A fault or a stop: the machine holds, what was measured is in the journal.
    pub async fn run(
        self,
        devices: &Devices,
        journal: &Journal,
        begun: impl FnOnce(RunId),
        tell: &mut dyn FnMut(&Event),
    ) -> Result<(RunId, Estimate), CycleError> {
        let Self { machine, method, plan, priors, answers } = self;
        let new = NewRun { config: machine.text().to_owned(), plan: plan.clone() };
        let id = journal.begin(&new).await?;
        begun(id);
        let run = Run::new(id, method.as_ref(), devices, journal, plan, tell);
        let mut run = run.asking(answers);
        let ended = run.execute().await;
        let estimate = conclude(run, ended, &method, priors, &machine.tolerance).await?;
        Ok((id, estimate))
    }
}

/// Identify, judge and store what a run has measured that came to its end.
///
/// # Errors
/// How the run `ended`; or why it is not identified.
pub async fn conclude(
    run: Run<'_>,
    ended: Result<(), RunError>,
    method: &Arc<dyn Method>,
    priors: Vec<Estimate>,
    tolerance: &[Limit],
) -> Result<Estimate, CycleError> {
    let can_resume = run.can_resume();
    let Run { id, plan, readings, moved, resumed, tell, journal, devices, .. } = run;
    if let Err(error) = ended {
        return Err(CycleError::Run { run: id, error, moved, resumed, can_resume });
    }
    let text = format!("identifying from {} readings", readings.len());
    tell(&Event::Announced { text });
    let found = identify(method, plan, readings, priors, &devices.controller.halt()).await;
    let estimate = found.map_err(|why| CycleError::Identification { run: id, why })?;
    let estimate = judged(estimate, tolerance);
    let unkept = |error: StoreError| CycleError::Identification { run: id, why: error.into() };
    journal.estimate(id, &estimate).await.map_err(unkept)?;
    Ok(estimate)
}

/// Beside the runtime, so that a stop is still heard: the thread is then left behind and ends with
/// the program.
async fn identify(
    method: &Arc<dyn Method>,
    plan: Plan,
    readings: Vec<Reading>,
    priors: Vec<Estimate>,
    halt: &Halt,
) -> Result<Estimate, Unidentified> {
    let method = method.clone();
    let (answer, mut result) = tokio::sync::oneshot::channel();
    std::thread::spawn(move || {
        behind(COMPUTING);
        drop(answer.send(method.identify(&plan, &readings, &priors)));
    });
    loop {
        // An answer not yet there leaves the receiver as it was.
        if let Ok(found) = tokio::time::timeout(STOP_POLL, &mut result).await {
            return Ok(found.map_err(|_| Unidentified::NoAnswer)??);
        }
        if halt.is_halted() {
            return Err(Unidentified::Stopped);
        }
    }
}

/// The estimate with its verdict, and a warning for every limit that nothing answers to.
pub fn judged(mut estimate: Estimate, tolerance: &[Limit]) -> Estimate {
    estimate.verdict = decision::judge(&estimate, tolerance);
    estimate.warnings.extend(decision::unmatched(&estimate, tolerance));
    estimate
}
