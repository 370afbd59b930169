//! Runs that were measured to their end and have no estimate, because their process ended first. They are
//! identified while the machine waits, without motion; a new cycle may begin meanwhile.

use tokio::sync::oneshot;
use tokio::sync::oneshot::error::TryRecvError;

use super::Log;
use super::desk::Desk;
use super::metrics::Outcome;
use crate::archive::story::identification_fault;
use crate::run::{Unidentified, start_identification, store_identification};
use crate::store::{Journal, RunId, RunState, StoreError, StoredRun};
use machine::record::estimate::Estimate;

/// The identification under way, and the runs that come after it.
#[derive(Default)]
pub(super) struct Identifications {
    /// The next one last.
    waiting: Vec<RunId>,
    computing: Option<(RunId, oneshot::Receiver<Result<Estimate, Unidentified>>)>,
}

impl Identifications {
    /// All runs of `machine` that wait for an identification. Only while this process has the machine: no other
    /// one computes an identification then.
    pub fn find(&mut self, journal: &Journal, machine: &str) -> Result<(), StoreError> {
        self.waiting = journal.not_identified(machine)?;
        Ok(())
    }

    pub fn add(&mut self, run: RunId) {
        self.waiting.push(run);
    }

    /// One step: stores the result of the identification under way, or begins the next. Never waits for a
    /// computation.
    pub async fn step(&mut self, desk: &Desk, log: &Log, journal: &Journal) {
        if let Some((run, mut result)) = self.computing.take() {
            let found = match result.try_recv() {
                Ok(found) => found,
                Err(TryRecvError::Closed) => Err(Unidentified::NoAnswer),
                Err(TryRecvError::Empty) => {
                    self.computing = Some((run, result));
                    return;
                }
            };
            let stored = store_identification(journal, run, found).await;
            return show_result(desk, log, run, stored);
        }
        match self.next(journal) {
            Ok(Some(stored)) => {
                let run = stored.summary.id;
                log.say(&format!("run {run} is measured and not identified: identifying it"));
                self.computing = Some((run, start_identification(stored)));
            }
            Ok(None) => {}
            Err(error) => log.fault(&format!("{error}; {}", error.remedy())),
        }
    }

    /// The newest run without an estimate whose identification has not failed before.
    fn next(&mut self, journal: &Journal) -> Result<Option<StoredRun>, StoreError> {
        while let Some(run) = self.waiting.pop() {
            let stored = journal.load(run)?;
            let is_open = stored.summary.state == RunState::NotIdentified;
            if is_open && identification_fault(&stored).is_none() {
                return Ok(Some(stored));
            }
        }
        Ok(None)
    }
}

fn show_result(desk: &Desk, log: &Log, run: RunId, stored: Result<Estimate, Unidentified>) {
    match stored {
        Ok(estimate) => {
            desk.tally().ended(Outcome::Judged(estimate.verdict));
            desk.show(|board| board.identified = board.identified.wrapping_add(1));
            log.say(&format!("run {run} is identified, verdict {}", estimate.verdict));
        }
        Err(why) => {
            desk.tally().ended(Outcome::Failed);
            let remedy = why.remedy().map_or(String::new(), |remedy| format!("; {remedy}"));
            log.fault(&format!("run {run} is not identified: {why}{remedy}"));
        }
    }
}
