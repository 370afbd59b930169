//! Result of each machine's newest finished run, whichever process measured it. It is read from the journal, so that
//! it survives a restart and has its time of measurement.

use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use serde::Serialize;
use utoipa::ToSchema;

use super::openapi::schemas::VerdictSchema;
use super::{AppState, ServedMachine};
use crate::service::command_gate::CommandGate;
use crate::service::machine_state::ServiceState;
use crate::service::result_metrics::NewestMethodResult;
use crate::store::{
    EstimateSelection, FinishedRunResult, Journal, NewestMeasuredRuns, RunFilter, RunState, StoreError,
};
use machine::record::estimate::Verdict;

/// Maximum time between two queries of the journal; another process that measures does not notify this service.
const JOURNAL_POLL_PERIOD: Duration = Duration::from_secs(10);
/// Maximum time by which a result may be later than the clock, because the clock may have been set back since.
const MAX_TOLERATED_CLOCK_SETBACK: SignedDuration = SignedDuration::from_hours(1);

/// Result of the newest finished run of a machine.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = NewestResult)]
pub struct NewestResult {
    pub run: i64,
    /// Time at which the run ended.
    #[schema(value_type = String, format = DateTime)]
    pub measured: Timestamp,
    #[schema(value_type = VerdictSchema)]
    pub verdict: Verdict,
    /// Whether the result no longer describes the machine: it is older than `[serve] verdict_h`, or more than one hour
    /// later than this computer's clock, or a newer run is measured and not identified.
    pub outdated: bool,
}

impl NewestResult {
    /// Newest result, with its validity at `now`. `None`: no run is finished.
    pub fn from_newest_runs(newest: &NewestMeasuredRuns, verdict_validity: Duration, now: Timestamp) -> Option<Self> {
        let FinishedRunResult { run, ended, verdict, .. } = newest.newest_result.as_ref()?;
        let outdated = has_invalid_age(*ended, verdict_validity, now) || newest.newer_run_without_estimate.is_some();
        Some(Self { run: run.0, measured: *ended, verdict: *verdict, outdated })
    }
}

/// Whether a result measured at `ended` is older than `verdict_validity`, or later than this computer's clock by more
/// than [`MAX_TOLERATED_CLOCK_SETBACK`].
fn has_invalid_age(ended: Timestamp, verdict_validity: Duration, now: Timestamp) -> bool {
    let validity = SignedDuration::try_from(verdict_validity).unwrap_or(SignedDuration::MAX);
    let age = now.duration_since(ended);
    age > validity || age < -MAX_TOLERATED_CLOCK_SETBACK
}

/// The newest result of each method on `machine`. It is outdated if its age is not valid at `now`, or if a newer run
/// of its method is measured and not identified.
///
/// # Errors
/// The journal cannot be read.
pub fn newest_result_of_each_method(
    journal: &Journal,
    machine: &ServedMachine,
    now: Timestamp,
) -> Result<Vec<NewestMethodResult>, StoreError> {
    let mut results = Vec::new();
    journal.visit_finished_run_results(&machine.name, 1, EstimateSelection::Last, |result| results.push(result))?;
    let with_validity = |result: FinishedRunResult| {
        let unidentified = RunFilter {
            newer_than: Some(result.run),
            machine: Some(&machine.name),
            method: Some(&result.method),
            state: Some(RunState::NotIdentified),
            ..RunFilter::default()
        };
        let outdated = has_invalid_age(result.ended, machine.gate.config.verdict_validity, now)
            || !journal.list_runs(unidentified, 1)?.is_empty();
        Ok(NewestMethodResult { machine: machine.name.clone(), result, outdated })
    };
    results.into_iter().map(with_validity).collect()
}

/// Queries the journal for the newest runs whenever a run may have ended, at least every [`JOURNAL_POLL_PERIOD`], for
/// as long as the process lives.
pub async fn refresh_newest_runs(app: AppState, machine: ServedMachine) {
    let mut changes = machine.gate.subscribe_changes();
    loop {
        let previous_key = result_change_key(&machine.gate);
        let (gate, name) = (machine.gate.clone(), machine.name.clone());
        // After an error there is no result, and the page shows it as unknown.
        let _ = app.read_journal(move |journal| gate.refresh_newest_runs(journal, &name)).await;
        let next_run_end =
            async { while changes.changed().await.is_ok() && result_change_key(&machine.gate) == previous_key {} };
        let _ = tokio::time::timeout(JOURNAL_POLL_PERIOD, next_run_end).await;
    }
}

/// Values that change when the journal may have another result: the state, the run whose verdict the gate has, and
/// the number of runs that were identified while the machine waited.
fn result_change_key(gate: &CommandGate) -> (ServiceState, Option<u32>, u16) {
    let machine_state = gate.machine_state();
    (machine_state.state, machine_state.verdict.map(|_| machine_state.run), machine_state.idle_identification_count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::RunId;

    #[test]
    fn verdict_is_outdated_after_its_validity_or_far_in_the_future() {
        let ended: Timestamp = "2026-11-22T05:30:00Z".parse().unwrap();
        let result = FinishedRunResult {
            run: RunId(7),
            started: ended,
            ended,
            method: String::new(),
            verdict: Verdict::Pass,
            parameters: Vec::new(),
            first_to_last_reading_s: None,
            temperatures_c: Default::default(),
        };
        let newest = NewestMeasuredRuns { newest_result: Some(result), newer_run_without_estimate: None };
        let (hours, validity) = (SignedDuration::from_hours, Duration::from_secs(192 * 3600));
        let outdated = |age| NewestResult::from_newest_runs(&newest, validity, ended + age).unwrap().outdated;
        assert!(!outdated(hours(0)) && !outdated(hours(192)));
        assert!(outdated(hours(193)) && outdated(hours(24 * 366)));
        // The clock was set back: by an hour, as after daylight saving time, and by a year.
        assert!(!outdated(hours(-1)) && outdated(hours(-24 * 365)));
    }
}
