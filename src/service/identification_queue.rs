//! Identification of runs that are completely measured but have no estimate, because their process ended first.
//! It runs while the machine waits, without motion; a new cycle may begin meanwhile.

use tokio::sync::oneshot;
use tokio::sync::oneshot::error::TryRecvError;

use super::Log;
use super::command_gate::CommandGate;
use super::machine_state::CycleOutcome;
use crate::archive::run_story::identification_fault;
use crate::run::{IdentificationError, start_identification, store_identification};
use crate::store::{Journal, RunId, RunState, StoreError, StoredRun};
use machine::record::estimate::Estimate;

/// The identification in progress, and the runs that wait for one.
#[derive(Default)]
pub(super) struct IdentificationQueue {
    /// Stack of the waiting runs: the last element is the next one.
    waiting_runs: Vec<RunId>,
    /// The run that is being identified on another thread, and the receiver of its estimate.
    in_progress: Option<(RunId, oneshot::Receiver<Result<Estimate, IdentificationError>>)>,
}

impl IdentificationQueue {
    /// Replaces the queue by all runs of `machine` that wait for an identification. Call it only while this process
    /// holds the machine's lock: then no other process computes an identification.
    pub fn queue_unidentified_runs(&mut self, journal: &Journal, machine: &str) -> Result<(), StoreError> {
        self.waiting_runs = journal.measured_runs_without_estimate(machine)?;
        Ok(())
    }

    /// Adds `run` as the next one.
    pub fn add_run(&mut self, run: RunId) {
        self.waiting_runs.push(run);
    }

    /// Stores the result of the identification in progress, or begins the next one. Never waits for a computation.
    pub async fn advance(&mut self, gate: &CommandGate, log: &Log, journal: &Journal) {
        if let Some((run, mut result)) = self.in_progress.take() {
            let outcome = match result.try_recv() {
                Ok(outcome) => outcome,
                Err(TryRecvError::Closed) => Err(IdentificationError::ThreadFailed),
                Err(TryRecvError::Empty) => {
                    self.in_progress = Some((run, result));
                    return;
                }
            };
            let stored = store_identification(journal, run, outcome).await;
            return publish_identification(gate, log, run, stored);
        }
        match self.pop_unidentified_run(journal) {
            Ok(Some(stored)) => {
                let run = stored.summary.id;
                log.info(&format!("run {run} is measured but not identified: the identification starts"));
                self.in_progress = Some((run, start_identification(stored)));
            }
            Ok(None) => {}
            Err(error) => log.error(&format!("{error}; {}", error.remedy())),
        }
    }

    /// Removes and returns the next waiting run; skips runs that have an estimate meanwhile, and runs whose
    /// identification has failed before.
    fn pop_unidentified_run(&mut self, journal: &Journal) -> Result<Option<StoredRun>, StoreError> {
        while let Some(run) = self.waiting_runs.pop() {
            let stored = journal.load_run(run)?;
            let is_open = stored.summary.state == RunState::NotIdentified;
            if is_open && identification_fault(&stored).is_none() {
                return Ok(Some(stored));
            }
        }
        Ok(None)
    }
}

/// Counts the outcome in the machine state and logs it. The verdict and the parameters in the machine state, which
/// are those of the last cycle, stay.
fn publish_identification(gate: &CommandGate, log: &Log, run: RunId, stored: Result<Estimate, IdentificationError>) {
    match stored {
        Ok(estimate) => {
            gate.update_machine_state(|machine_state| {
                machine_state.count_outcome(CycleOutcome::Judged(estimate.verdict));
                machine_state.idle_identification_count = machine_state.idle_identification_count.wrapping_add(1)
            });
            log.info(&format!("run {run} is identified, verdict {}", estimate.verdict));
        }
        Err(why) => {
            gate.update_machine_state(|machine_state| machine_state.count_outcome(CycleOutcome::Failed));
            let remedy = why.remedy().map_or(String::new(), |remedy| format!("; {remedy}"));
            log.error(&format!("run {run} is not identified: {why}{remedy}"));
        }
    }
}
