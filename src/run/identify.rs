//! Computes and stores the estimate of a completed measurement from its readings. No connection to the machine is
//! needed.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::oneshot;

use super::priority::spawn_computation;
use crate::setup::{MachineFile, SetupError};
use crate::store::{Journal, RunId, StoreError, StoredRun, sha256_of_json};
use devices::controllers::HaltHandle;
use machine::Axis;
use machine::record::estimate::{Estimate, ParameterTolerance, Provenance};
use machine::record::event::RunEvent;
use machine::record::plan::Plan;
use machine::record::reading::Reading;
use methods::decision;
use methods::identification::add_budget_sensitivities;
use methods::prediction::{ErrorPredictor, VOLUMETRIC_ERROR_SYMBOL};
use methods::{IdentifyError, Method};

/// Polling period for a stop while the identification runs.
const HALT_POLL_PERIOD: Duration = Duration::from_millis(50);

/// Reason why a completed measurement has no estimate.
#[derive(Debug, thiserror::Error)]
pub enum IdentificationError {
    #[error(transparent)]
    Refused(#[from] IdentifyError),
    /// The machine file or the settings of the run belong to another version of this program.
    #[error(transparent)]
    Setup(Box<SetupError>),
    #[error("the computation of the estimate ended without a result")]
    ThreadFailed,
    #[error("stopped during the computation of the estimate")]
    Stopped,
    /// The estimate exists but is not stored. It can be computed from the readings again.
    #[error("the estimate could not be stored: {0}")]
    NotStored(#[from] StoreError),
}

impl IdentificationError {
    /// Remedy to show to the user.
    pub fn remedy(&self) -> Option<String> {
        match self {
            Self::Refused(error) => Some(error.remedy()),
            Self::Setup(error) => error.remedy(),
            Self::ThreadFailed => {
                Some("report this fault to the developers and attach the export of the run".to_owned())
            }
            Self::NotStored(_) => Some("free space on the disk of the journal, or repair the disk".to_owned()),
            Self::Stopped => None,
        }
    }

    /// Whether another identification of the same readings fails as well.
    fn is_permanent(&self) -> bool {
        matches!(self, Self::Refused(_) | Self::Setup(_) | Self::ThreadFailed)
    }
}

/// Identifies and judges the run on a separate thread. A stop ends the wait within [`HALT_POLL_PERIOD`], but not the
/// computation, whose result is dropped.
pub(super) async fn identify_and_judge_until_halted(
    method: &Arc<dyn Method>,
    plan: Plan,
    readings: Vec<Reading>,
    tolerances: &[ParameterTolerance],
    halt: &HaltHandle,
) -> Result<Estimate, IdentificationError> {
    let (method, tolerances) = (method.clone(), tolerances.to_vec());
    let mut result = spawn_computation(move || {
        let estimate = identify_readings(method.as_ref(), &plan, &readings)?;
        Ok::<_, IdentifyError>(judge_estimate(estimate, &plan, &tolerances))
    });
    loop {
        // A timeout leaves the receiver usable.
        if let Ok(found) = tokio::time::timeout(HALT_POLL_PERIOD, &mut result).await {
            return Ok(found.map_err(|_| IdentificationError::ThreadFailed)??);
        }
        if halt.is_halt_requested() {
            return Err(IdentificationError::Stopped);
        }
    }
}

/// Machine file and method with which the run was started.
pub(super) fn setup_of_stored_run(stored: &StoredRun) -> Result<(MachineFile, Arc<dyn Method>), SetupError> {
    let file = format!("machine file of run {}", stored.summary.id);
    let machine = MachineFile::from_stored_run(&file, stored.machine_file_text.clone(), &stored.plan.artefact)?;
    let method = methods::configure_method(&stored.plan.method, stored.plan.settings.clone())
        .map_err(|error| SetupError::MethodSettings { why: error.to_string() })?;
    Ok((machine, method.into()))
}

/// Identifies a stored run that was measured to its end, and judges it by the tolerances of its own machine
/// file. Blocks the thread.
///
/// # Errors
/// The method refuses the readings, or the machine file belongs to another version.
pub fn identify_stored_run(stored: StoredRun) -> Result<Estimate, IdentificationError> {
    let unreadable = |error| IdentificationError::Setup(Box::new(error));
    let (machine, method) = setup_of_stored_run(&stored).map_err(unreadable)?;
    let estimate = identify_readings(method.as_ref(), &stored.plan, &stored.readings)?;
    Ok(judge_estimate(estimate, &stored.plan, &machine.tolerances))
}

/// Runs [`identify_stored_run`] on a thread of its own. A channel error means that the thread panicked.
pub fn start_identification(stored: StoredRun) -> oneshot::Receiver<Result<Estimate, IdentificationError>> {
    spawn_computation(move || identify_stored_run(stored))
}

/// Stores the result of an identification of `run`: the estimate, or the failure as a fault. A stop is not
/// stored; the run is identified later.
///
/// # Errors
/// The reason why the journal has no estimate.
pub async fn store_identification(
    journal: &Journal,
    run: RunId,
    identification_result: Result<Estimate, IdentificationError>,
) -> Result<Estimate, IdentificationError> {
    match identification_result {
        Ok(estimate) => {
            journal.add_estimate(run, &estimate).await?;
            Ok(estimate)
        }
        Err(why) => {
            if why.is_permanent() {
                let what = format!("no estimate: {why}");
                let remedy = why.remedy().unwrap_or_default();
                let fault = RunEvent::Faulted { what, remedy, position_lost: false };
                journal.add_event(run, &fault).await?;
            }
            Err(why)
        }
    }
}

/// Identifies the readings of `plan`, without a verdict. Adds to the estimate the ranges of the axes, the sensitivities
/// of the budget, the provenance (program, machine, temperatures, hashes) and the hashes of the priors.
///
/// # Errors
/// The errors of [`Method::identify`].
pub fn identify_readings(method: &dyn Method, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
    let mut estimate = method.identify(plan, readings)?;
    estimate.measured_ranges = axis_ranges(readings);
    add_budget_sensitivities(&mut estimate, plan);
    estimate.provenance = estimate_provenance(plan, readings);
    estimate.prior_hashes = plan.priors.iter().filter_map(|prior| sha256_of_json(prior).ok()).collect();
    Ok(estimate)
}

/// Hash of the identity of the plan's probe, without its declared uncertainties, and of its stylus position. `None`: a
/// value cannot be written as JSON.
pub fn probe_sha256(plan: &Plan) -> Option<String> {
    sha256_of_json(&(plan.probe.identity(), plan.machine.tool_mm)).ok()
}

/// Provenance of the estimate. `None`: a value cannot be written as JSON.
fn estimate_provenance(plan: &Plan, readings: &[Reading]) -> Option<Provenance> {
    let times = readings.iter().map(|reading| reading.t_s);
    let [first, last] = [times.clone().reduce(f64::min), times.reduce(f64::max)];
    let mut temperatures_c: BTreeMap<String, [f64; 2]> = BTreeMap::new();
    for (name, value) in readings.iter().flat_map(|reading| reading.temperatures_c.iter()) {
        let [least, most] = temperatures_c.entry(name.to_owned()).or_insert([value; 2]);
        (*least, *most) = (least.min(value), most.max(value));
    }
    Some(Provenance {
        program: match option_env!("TRUED_COMMIT") {
            Some(commit) => format!("trued {} ({commit})", env!("CARGO_PKG_VERSION")),
            None => concat!("trued ", env!("CARGO_PKG_VERSION")).to_owned(),
        },
        machine: plan.machine.name.clone(),
        plan_sha256: sha256_of_json(plan).ok()?,
        readings_sha256: sha256_of_json(&readings).ok()?,
        probe_sha256: probe_sha256(plan)?,
        artefact_sha256: sha256_of_json(&plan.artefact).ok()?,
        compensations_active: plan.compensations_active.clone(),
        duration_s: last.zip(first).map_or(0.0, |(last, first)| last - first),
        temperatures_c,
        combined_runs: Vec::new(),
    })
}

/// Minimum and maximum position of each axis, mm and degrees, rounded outwards to three decimals.
fn axis_ranges(readings: &[Reading]) -> BTreeMap<Axis, [f64; 2]> {
    let mut ranges: BTreeMap<Axis, [f64; 2]> = BTreeMap::new();
    for (axis, value) in readings.iter().flat_map(|reading| reading.position.iter()) {
        let value = axis.to_mm_or_deg(value);
        let [least, most] = ranges.entry(axis).or_insert([value; 2]);
        (*least, *most) = (least.min(value), most.max(value));
    }
    let rounded = |[least, most]: [f64; 2]| [(least * 1e3).floor() / 1e3, (most * 1e3).ceil() / 1e3];
    ranges.into_iter().map(|(axis, range)| (axis, rounded(range))).collect()
}

/// The estimate with its verdict, and a warning for each limit that matches no parameter. With a limit for the
/// volumetric error, the estimate gets this parameter, or a warning if it cannot be computed.
pub fn judge_estimate(mut estimate: Estimate, plan: &Plan, tolerances: &[ParameterTolerance]) -> Estimate {
    if tolerances.iter().any(|limit| limit.symbol == VOLUMETRIC_ERROR_SYMBOL) {
        let predictor = ErrorPredictor::of_plan(plan, &estimate);
        match predictor.and_then(|predictor| predictor.volumetric_error_parameter()) {
            Ok(parameter) => estimate.parameters.push(parameter),
            Err(why) => estimate.warnings.push(format!("the volumetric error was not computed: {why}")),
        }
    }
    decision::judge_estimate(&mut estimate, tolerances);
    estimate.warnings.extend(decision::describe_unmatched_tolerances(&estimate, tolerances));
    estimate
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::plan_for_tests;
    use crate::archive::run_story::{describe_run_end, next_action};
    use crate::store::{NewRun, RunState};

    #[tokio::test]
    async fn failed_identification_is_stored_with_its_reason_but_a_stop_is_not() {
        let dir = tempfile::tempdir().unwrap();
        let journal = Journal::open(dir.path()).unwrap();
        let new = NewRun { machine_file_text: String::new(), plan: plan_for_tests("samba", "mill") };
        let run = journal.begin_run(&new).await.unwrap();
        journal.set_state(run, RunState::NotIdentified).await.unwrap();
        let ended = || describe_run_end(&journal.load_run(run).unwrap());
        let stopped = store_identification(&journal, run, Err(IdentificationError::Stopped)).await;
        assert!(matches!(stopped, Err(IdentificationError::Stopped)));
        assert!(ended().ends_with("not identified after 0 readings: no estimate is stored yet"));
        let refused = IdentifyError::IdentificationFailed("nothing converges".to_owned());
        let refused = store_identification(&journal, run, Err(refused.into())).await;
        assert!(matches!(refused, Err(IdentificationError::Refused(_))));
        assert!(ended().contains("no estimate: the identification failed: nothing converges ("));
        let stored = journal.load_run(run).unwrap();
        assert_eq!(stored.summary.state, RunState::NotIdentified);
        assert!(next_action(&stored, true).unwrap().starts_with("`trued resume 1` computes the estimate"));
    }
}
