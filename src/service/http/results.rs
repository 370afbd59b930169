//! Result of each machine's newest finished run, whichever process measured it. It is read from the journal, so that
//! it survives a restart and has its time of measurement.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use serde::Serialize;
use tokio::sync::watch;
use utoipa::ToSchema;

use super::journal::read_journal;
use super::openapi::views::VerdictView;
use super::{AppState, ServedMachine};
use crate::service::command_gate::CommandGate;
use crate::service::machine_state::State;
use crate::store::{Journal, LatestResult, NewestRuns, RunId, StoreError};
use machine::record::estimate::{Parameter, Verdict};

/// Period of the journal query; another process that measures does not notify this service.
const POLL_PERIOD: Duration = Duration::from_secs(10);
/// Maximum time by which a result may be later than the clock, because the clock may have been set back since.
const MAX_CLOCK_SETBACK: SignedDuration = SignedDuration::from_hours(1);

/// Newest result of one machine, as of the last query.
#[derive(Debug, Clone)]
pub struct Last {
    newest: Arc<Mutex<NewestRuns>>,
    /// Serialises the queries, so that an older result never replaces a newer one.
    turn: Arc<Mutex<()>>,
    /// Counter of the changes.
    changes: Arc<watch::Sender<u64>>,
    /// Time for which a verdict stays valid.
    holds: SignedDuration,
}

impl Last {
    pub fn new(holds: Duration) -> Self {
        let holds = SignedDuration::try_from(holds).unwrap_or(SignedDuration::MAX);
        let (newest, turn) = (Arc::default(), Arc::default());
        Self { newest, turn, changes: Arc::new(watch::Sender::new(0)), holds }
    }

    pub fn changes(&self) -> watch::Receiver<u64> {
        self.changes.subscribe()
    }

    /// Queries the journal again. Blocks this thread.
    ///
    /// # Errors
    /// The journal cannot be read; the previous result is discarded.
    pub fn look(&self, journal: &Journal, machine: &str) -> Result<(), StoreError> {
        let turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        let (found, error) = match journal.newest(machine) {
            Ok(found) => (found, None),
            Err(error) => (NewestRuns::default(), Some(error)),
        };
        let mut newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner);
        let changed = *newest != found;
        *newest = found;
        drop(newest);
        drop(turn);
        if changed {
            self.changes.send_modify(|count| *count = count.wrapping_add(1));
        }
        error.map_or(Ok(()), Err)
    }

    /// Newest result, with its validity at `now`, and its values.
    pub fn at(&self, now: Timestamp) -> Option<(NewestResult, Vec<Parameter>)> {
        let NewestRuns { result, not_identified } = self.newest_runs();
        result.map(|newest| {
            let mut told = NewestResult::of(&newest, self.holds, now);
            told.outdated |= not_identified.is_some();
            (told, newest.parameters)
        })
    }

    /// The newest completely measured run, if it has no estimate.
    pub fn not_identified(&self) -> Option<RunId> {
        self.newest_runs().not_identified
    }

    fn newest_runs(&self) -> NewestRuns {
        self.newest.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Result of the newest finished run of a machine.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = NewestResult)]
pub struct NewestResult {
    pub run: i64,
    /// Time at which the run ended.
    #[schema(value_type = String, format = DateTime)]
    pub measured: Timestamp,
    #[schema(value_type = VerdictView)]
    pub verdict: Verdict,
    /// Whether the result no longer describes the machine: it is older than `[serve] verdict_h`, or later than this
    /// computer's clock, or a newer run is measured and not identified.
    pub outdated: bool,
}

impl NewestResult {
    fn of(newest: &LatestResult, holds: SignedDuration, now: Timestamp) -> Self {
        let LatestResult { run, ended, verdict, .. } = newest;
        let age = now.duration_since(*ended);
        let outdated = age > holds || age < -MAX_CLOCK_SETBACK;
        Self { run: run.0, measured: *ended, verdict: *verdict, outdated }
    }
}

/// Queries the journal whenever a run may have ended, for as long as the process lives.
pub async fn follow(web: AppState, machine: ServedMachine) {
    let mut changes = machine.gate.changes();
    loop {
        let seen = ended(&machine.gate);
        let (last, name) = (machine.last.clone(), machine.name.clone());
        // After an error there is no result, and the page shows it as unknown.
        let _ = read_journal(&web, move |journal| last.look(journal, &name)).await;
        let other =
            async { while changes.changed().await.is_ok() && ended(&machine.gate) == seen {} };
        let _ = tokio::time::timeout(POLL_PERIOD, other).await;
    }
}

/// Values that change when the journal may have another result: the state, the run whose verdict the gate has, and
/// the number of runs that were identified while the machine waited.
fn ended(gate: &CommandGate) -> (State, Option<u32>, u16) {
    let machine_state = gate.machine_state();
    (
        machine_state.state,
        machine_state.verdict.map(|_| machine_state.run),
        machine_state.identified,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::RunId;

    #[test]
    fn a_verdict_has_its_time() {
        let ended: Timestamp = "2026-11-22T05:30:00Z".parse().unwrap();
        let newest =
            LatestResult { run: RunId(7), ended, verdict: Verdict::Pass, parameters: Vec::new() };
        let hours = SignedDuration::from_hours;
        let outdated = |age| NewestResult::of(&newest, hours(192), ended + age).outdated;
        assert!(!outdated(hours(0)) && !outdated(hours(192)));
        assert!(outdated(hours(193)) && outdated(hours(24 * 366)));
        // The clock was set back: by an hour, as after daylight saving time, and by a year.
        assert!(!outdated(hours(-1)) && outdated(hours(-24 * 365)));
    }
}
