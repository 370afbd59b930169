//! Combination of stored runs of one machine into one estimate of the newest of them.

use super::identify::{IdentificationError, judge_estimate, setup_of_stored_run};
use crate::compensation::recorded_compensation_file_values;
use crate::setup::{ControlConfig, MachineFile};
use crate::store::{Journal, RunId, RunState, StoreError, StoredRun};
use machine::record::estimate::{Estimate, SourceEffect};
use methods::MethodRefusal;
use methods::combination::{Combination, CombinationRefusal, MeasuredRun, combine_runs};

/// Reason why stored runs are not combined.
#[derive(Debug, thiserror::Error)]
pub enum CombinationError {
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Refused(#[from] CombinationRefusal),
    #[error("run {run} cannot be identified again: {error}")]
    NotIdentifiedAgain { run: RunId, error: IdentificationError },
    /// The run is not finished, or has no estimate of its own readings.
    #[error("run {0} is not finished")]
    NotFinished(RunId),
    #[error("run {run}, of the method {method}, has an estimate of other inputs or of another version of this program")]
    EstimateNotReproduced { run: RunId, method: String },
    #[error(
        "the records do not confirm that the control used the same compensation files during the runs {one} and \
         {other}: the readings contain the effect of these files"
    )]
    CompensationValuesMismatch { one: RunId, other: RunId },
    #[error("run {simulated} was measured on a simulated control, run {real} on the machine")]
    SimulatedAndReal { simulated: RunId, real: RunId },
}

impl CombinationError {
    /// Remedy to show to the user.
    pub fn remedy(&self) -> Option<String> {
        match self {
            Self::Store(error) => Some(error.remedy().to_owned()),
            Self::Refused(refusal) => Some(refusal.remedy()),
            Self::NotIdentifiedAgain { error, .. } => error.remedy(),
            Self::NotFinished(run) => Some(format!("`trued show {run}` states the next action")),
            Self::EstimateNotReproduced { run, method } => {
                Some(format!("compute its estimate again with `trued identify {method} --run {run}`"))
            }
            Self::CompensationValuesMismatch { .. } => Some("choose runs after the last compensation".to_owned()),
            Self::SimulatedAndReal { .. } => Some("choose runs that were measured on the real machine".to_owned()),
        }
    }
}

/// A stored run with its own estimate, its machine file and the effects of its sources.
struct IdentifiedRun {
    stored: StoredRun,
    /// Last stored estimate of the readings of this run alone.
    estimate: Estimate,
    /// Machine file with which the run was measured.
    machine: MachineFile,
    /// From the repeated identification, because the journal does not contain them.
    source_effects: Vec<SourceEffect>,
}

impl IdentifiedRun {
    fn is_simulated(&self) -> bool {
        matches!(self.machine.controller_section.control, ControlConfig::Simulated(_))
    }

    fn id(&self) -> RunId {
        self.stored.summary.id
    }
}

/// Combines the own estimates of the runs and judges the result by the tolerances of the newest run. If the runs agree,
/// stores the result as a new estimate of the newest run. `trued identify --run` restores the own estimate of that run.
///
/// # Errors
/// A run has no estimate of its own readings, or the runs cannot be combined.
pub fn combine_stored_runs(journal: &Journal, runs: &[RunId]) -> Result<Combination, CombinationError> {
    let mut identified = Vec::new();
    for (index, run) in runs.iter().enumerate() {
        if runs[..index].contains(run) {
            return Err(CombinationRefusal::DuplicateRun(run.0).into());
        }
        identified.push(identify_again(journal.load_run(*run)?)?);
    }
    check_all_simulated_or_all_real(&identified)?;
    check_same_compensation_values(&identified)?;
    let measured = identified.iter().map(|run| MeasuredRun {
        number: run.id().0,
        plan: &run.stored.plan,
        estimate: &run.estimate,
        source_effects: &run.source_effects,
    });
    let mut combination = combine_runs(&measured.collect::<Vec<_>>())?;
    if let Some(newest) = identified.iter().max_by_key(|run| run.id()) {
        combination.estimate = judge_estimate(combination.estimate, &newest.stored.plan, &newest.machine.tolerances);
        if combination.consistency.is_consistent() {
            journal.add_estimate(newest.id(), &combination.estimate).wait()?;
        }
    }
    Ok(combination)
}

/// Identifies the run again, because the journal does not contain the effects of the sources.
fn identify_again(stored: StoredRun) -> Result<IdentifiedRun, CombinationError> {
    let run = stored.summary.id;
    let own = stored.own_estimate().filter(|_| stored.summary.state == RunState::Finished);
    let estimate = own.cloned().ok_or(CombinationError::NotFinished(run))?;
    let of_run = |error: IdentificationError| CombinationError::NotIdentifiedAgain { run, error };
    let mut stored_with_few_trials = stored.clone();
    if let Some(trials) = stored_with_few_trials.plan.settings.get_mut("monte_carlo_trials") {
        // Values, covariance and effects do not depend on the trials.
        *trials = MethodRefusal::MIN_MONTE_CARLO_TRIALS.into();
    }
    let setup = setup_of_stored_run(&stored_with_few_trials);
    let (machine, method) = setup.map_err(|error| of_run(IdentificationError::Setup(Box::new(error))))?;
    let again = method.identify(&stored_with_few_trials.plan, &stored.readings);
    let again = again.map_err(|error| of_run(error.into()))?;
    if !is_same_result(&again, &estimate) {
        return Err(CombinationError::EstimateNotReproduced { run, method: stored.plan.method.clone() });
    }
    Ok(IdentifiedRun { estimate, machine, source_effects: again.source_effects, stored })
}

/// Largest difference of values and covariances that counts as rounding, in standard uncertainties.
const SAME_RESULT_TOLERANCE_STD_U: f64 = 1e-6;

/// Whether two estimates have the same values and the same covariance, apart from rounding
/// ([`SAME_RESULT_TOLERANCE_STD_U`]). Functions are not compared.
fn is_same_result(one: &Estimate, other: &Estimate) -> bool {
    let (a, b) = (&one.covariance, &other.covariance);
    let value = |estimate: &Estimate, symbol: &str| {
        estimate.parameters.iter().find(|own| own.symbol == symbol).map_or(f64::NAN, |own| own.value)
    };
    let is_near = |difference: f64, scale: f64| difference.abs() <= SAME_RESULT_TOLERANCE_STD_U * scale;
    let u = |index: usize| a.rows[index][index].sqrt();
    a.symbols == b.symbols
        && a.symbols.iter().enumerate().all(|(i, symbol)| {
            let entries = a.rows[i].iter().zip(&b.rows[i]).enumerate();
            is_near(value(one, symbol) - value(other, symbol), u(i))
                && entries.into_iter().all(|(j, (a, b))| is_near(a - b, u(i) * u(j)))
        })
}

/// Checks that the readings of all runs contain the effect of the same compensation files; files without recorded
/// values count as different.
fn check_same_compensation_values(runs: &[IdentifiedRun]) -> Result<(), CombinationError> {
    let is_same = |pair: &&[IdentifiedRun]| {
        let one = recorded_compensation_file_values(&pair[0].machine, &pair[0].stored);
        one.is_some() && one == recorded_compensation_file_values(&pair[1].machine, &pair[1].stored)
    };
    match runs.windows(2).find(|pair| !is_same(pair)) {
        Some([one, other]) => Err(CombinationError::CompensationValuesMismatch { one: one.id(), other: other.id() }),
        _ => Ok(()),
    }
}

/// Checks that the control was simulated in all runs or in none.
fn check_all_simulated_or_all_real(runs: &[IdentifiedRun]) -> Result<(), CombinationError> {
    let simulated = runs.iter().find(|run| run.is_simulated());
    let real = runs.iter().find(|run| !run.is_simulated());
    match simulated.zip(real) {
        Some((simulated, real)) => {
            Err(CombinationError::SimulatedAndReal { simulated: simulated.id(), real: real.id() })
        }
        None => Ok(()),
    }
}
