//! What each machine's newest finished run has told, whoever measured it and before whichever restart: read
//! from the journal, since a verdict without its time is worth nothing.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use serde::Serialize;
use tokio::sync::watch;
use utoipa::ToSchema;

use super::journal::read_journal;
use super::openapi::views::VerdictView;
use super::{Shown, Web};
use crate::service::board::State;
use crate::service::desk::Desk;
use crate::store::{Journal, Newest, NewestRuns, RunId, StoreError};
use machine::record::estimate::{Parameter, Verdict};

/// Whoever measures beside this service tells nobody: looked for so often.
const AGAIN: Duration = Duration::from_secs(10);
/// A clock may have been set by so much since.
const AHEAD: SignedDuration = SignedDuration::from_hours(1);

/// Of one machine, as of the last look.
#[derive(Debug, Clone)]
pub struct Last {
    newest: Arc<Mutex<NewestRuns>>,
    /// One looks at a time: what was read earlier never takes the place of what was read later.
    turn: Arc<Mutex<()>>,
    /// Counts what changed.
    changes: Arc<watch::Sender<u64>>,
    /// A verdict says so long how the machine is.
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

    /// Look anew. Blocks this thread.
    ///
    /// # Errors
    /// The journal cannot be read; what was known of it is forgotten.
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

    /// As seen at `now`, with its values.
    pub fn at(&self, now: Timestamp) -> Option<(Told, Vec<Parameter>)> {
        let NewestRuns { result, not_identified } = self.newest_runs();
        result.map(|newest| {
            let mut told = Told::of(&newest, self.holds, now);
            told.outdated |= not_identified.is_some();
            (told, newest.parameters)
        })
    }

    /// The newest run that was measured to its end, if it has no estimate.
    pub fn not_identified(&self) -> Option<RunId> {
        self.newest_runs().not_identified
    }

    fn newest_runs(&self) -> NewestRuns {
        self.newest.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// The newest finished run of a machine.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = NewestResult)]
pub struct Told {
    pub run: i64,
    /// When it came to its end.
    #[schema(value_type = String, format = DateTime)]
    pub measured: Timestamp,
    #[schema(value_type = VerdictView)]
    pub verdict: Verdict,
    /// Longer ago than `[serve] verdict_h`, or ahead of this computer's clock, or a newer run is measured and
    /// not identified: it does not say any more how the machine is.
    pub outdated: bool,
}

impl Told {
    fn of(newest: &Newest, holds: SignedDuration, now: Timestamp) -> Self {
        let Newest { run, ended, verdict, .. } = newest;
        let age = now.duration_since(*ended);
        let outdated = age > holds || age < -AHEAD;
        Self { run: run.0, measured: *ended, verdict: *verdict, outdated }
    }
}

/// Look whenever a run may have come to its end, for as long as the process lives.
pub async fn follow(web: Web, machine: Shown) {
    let mut changes = machine.desk.changes();
    loop {
        let seen = ended(&machine.desk);
        let (last, name) = (machine.last.clone(), machine.name.clone());
        // Without an answer nothing is known, and the page says so.
        let _ = read_journal(&web, move |journal| last.look(journal, &name)).await;
        let other =
            async { while changes.changed().await.is_ok() && ended(&machine.desk) == seen {} };
        let _ = tokio::time::timeout(AGAIN, other).await;
    }
}

/// What changes when the journal may have another result: the state, the run whose verdict the desk knows, and
/// the count of runs that were identified since.
fn ended(desk: &Desk) -> (State, Option<u32>, u16) {
    let board = desk.board();
    (board.state, board.verdict.map(|_| board.run), board.identified)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::RunId;

    #[test]
    fn a_verdict_has_its_time() {
        let ended: Timestamp = "2026-11-22T05:30:00Z".parse().unwrap();
        let newest =
            Newest { run: RunId(7), ended, verdict: Verdict::Pass, parameters: Vec::new() };
        let hours = SignedDuration::from_hours;
        let outdated = |age| Told::of(&newest, hours(192), ended + age).outdated;
        assert!(!outdated(hours(0)) && !outdated(hours(192)));
        assert!(outdated(hours(193)) && outdated(hours(24 * 366)));
        // The clock was set back: by what daylight saving and a slow clock do, and by a year.
        assert!(!outdated(hours(-1)) && outdated(hours(-24 * 365)));
    }
}
