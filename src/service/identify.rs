//! Identification of runs that are completely measured but have no estimate, because their process ended first.
//! It runs while the machine waits, without motion; a new cycle may begin meanwhile.

use tokio::sync::oneshot;
use tokio::sync::oneshot::error::TryRecvError;

use super::Log;
use super::command_gate::CommandGate;
use super::metrics::Outcome;
use crate::archive::story::identification_fault;
use crate::run::{Unidentified, start_identification, store_identification};
use crate::store::{Journal, RunId, RunState, StoreError, StoredRun};
use machine::record::estimate::Estimate;

/// The identification in progress, and the runs that wait for one.
#[derive(Default)]
pub(super) struct Identifications {
    /// Stack of the waiting runs: the last element is the next one.
    waiting: Vec<RunId>,
    computing: Option<(RunId, oneshot::Receiver<Result<Estimate, Unidentified>>)>,
}

impl Identifications {
    /// Finds all runs of `machine` that wait for an identification. Call it only while this process holds the
    /// machine's lock: then no other process computes an identification.
    pub fn find(&mut self, journal: &Journal, machine: &str) -> Result<(), StoreError> {
        self.waiting = journal.not_identified(machine)?;
        Ok(())
    }

    pub fn add(&mut self, run: RunId) {
        self.waiting.push(run);
    }

    /// Stores the result of the identification in progress, or begins the next one. Never waits for a computation.
    pub async fn step(&mut self, gate: &CommandGate, log: &Log, journal: &Journal) {
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
            return show_result(gate, log, run, stored);
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

    /// The newest run without an estimate, except runs whose identification has failed before.
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

fn show_result(gate: &CommandGate, log: &Log, run: RunId, stored: Result<Estimate, Unidentified>) {
    match stored {
        Ok(estimate) => {
            gate.update(|machine_state| {
                machine_state.count_outcome(Outcome::Judged(estimate.verdict));
                machine_state.identified = machine_state.identified.wrapping_add(1)
            });
            log.say(&format!("run {run} is identified, verdict {}", estimate.verdict));
        }
        Err(why) => {
            gate.update(|machine_state| machine_state.count_outcome(Outcome::Failed));
            let remedy = why.remedy().map_or(String::new(), |remedy| format!("; {remedy}"));
            log.fault(&format!("run {run} is not identified: {why}{remedy}"));
        }
    }
}
