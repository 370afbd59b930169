//! Resume of a run by a person at the page.

use std::collections::BTreeSet;

use super::ServeError;
use super::captures::Begun;
use super::cycle_failure::CycleFailure;
use super::machine_state::{Refusal, State};
use super::run_events::RunEvents;
use super::worker::MachineWorker;
use super::worker_command::Acknowledgement;
use crate::run::{AgainError, ResumableRun};
use crate::setup;
use crate::store::{Journal, RunId};
use machine::record::estimate::Estimate;
use machine::record::event::Event;

/// Why a run cannot be resumed.
#[derive(Debug, thiserror::Error)]
enum ResumeError {
    #[error(transparent)]
    Serve(#[from] ServeError),
    #[error(transparent)]
    ResumableRun(#[from] AgainError),
}

impl MachineWorker {
    /// Prepares the resume of a run: this process acquires the machine's lock and writes the acknowledgement to the
    /// journal. Returns `None` after a refusal; the lock is then released, so that another process may resume the run.
    pub(super) async fn acknowledged_again(
        &mut self,
        run: RunId,
        acknowledgement: Acknowledgement,
        journal: &Journal,
    ) -> Option<ResumableRun> {
        let Acknowledgement { who, homed, answer, .. } = acknowledgement;
        match self.let_go_on(run, (&who, homed), journal).await {
            Ok(again) => {
                let _ = answer.send(Ok(()));
                Some(again)
            }
            Err(error) => {
                let why = match error {
                    ResumeError::Serve(ServeError::Lock(_)) => Refusal::Elsewhere,
                    ResumeError::ResumableRun(AgainError::NotHomed(_)) => Refusal::PositionLost,
                    _ => Refusal::NotReady,
                };
                self.gate.refuse(why, &format!("resume of run {run} by {who} ({error})"));
                self.lock = None;
                self.gate.finish_command(State::Held);
                let _ = answer.send(Err(why));
                None
            }
        }
    }

    async fn let_go_on(
        &mut self,
        run: RunId,
        (who, homed): (&str, bool),
        journal: &Journal,
    ) -> Result<ResumableRun, ResumeError> {
        if self.lock.is_none() {
            self.lock = Some(self.acquire_lock(journal).await?);
        }
        // Another process may have resumed the run meanwhile: the journal's current content decides.
        let again = ResumableRun::of(journal.load(run).map_err(ServeError::from)?)?;
        let acknowledged = again.acknowledged(who, homed)?;
        journal.event(run, &acknowledged).await.map_err(ServeError::from)?;
        Ok(again)
    }

    pub(super) async fn measured_again(
        &self,
        again: ResumableRun,
        journal: &Journal,
    ) -> Result<(RunId, Estimate), CycleFailure> {
        let opening = setup::devices(&again.machine, self.pace, again.past());
        let (devices, capture) = self.open(opening).await?;
        let mut events = RunEvents::new(&self.gate, &self.log, self.patience());
        let mut tell = |event: &Event| events.publish(event);
        capture.iter().for_each(|capture| capture.is_of(again.stored().summary.id));
        let readings = again.stored().readings.iter();
        let kept: BTreeSet<_> = readings.map(|reading| (reading.step, reading.repeat)).collect();
        self.gate.update(|machine_state| {
            machine_state.measured = u32::try_from(kept.len()).unwrap_or(u32::MAX)
        });
        let answers = self.gate.answers(self.patience());
        let ended = again.run(&devices, journal, answers, &mut tell).await;
        capture.into_iter().for_each(Begun::finish);
        Ok(ended?)
    }
}
