//! A person at the page lets a run go on.

use std::collections::BTreeSet;

use super::ServeError;
use super::ask::Word;
use super::attend::{Attendant, Failed, Progress};
use super::board::{Refusal, State};
use super::captures::Begun;
use crate::run::{Again, AgainError};
use crate::setup;
use crate::store::{Journal, RunId};
use machine::record::estimate::Estimate;
use machine::record::event::Event;

/// Why a run does not go on.
#[derive(Debug, thiserror::Error)]
enum NotAgain {
    #[error(transparent)]
    Serve(#[from] ServeError),
    #[error(transparent)]
    Again(#[from] AgainError),
}

impl Attendant {
    /// The run that a person has let go on: the machine is ours, the word is in the journal. `None` once it
    /// is told why not, and the machine is left to whoever else may resume it.
    pub(super) async fn acknowledged_again(
        &mut self,
        run: RunId,
        word: Word,
        journal: &Journal,
    ) -> Option<Again> {
        let Word { who, homed, answer, .. } = word;
        match self.let_go_on(run, (&who, homed), journal).await {
            Ok(again) => {
                let _ = answer.send(Ok(()));
                Some(again)
            }
            Err(error) => {
                let why = match error {
                    NotAgain::Serve(ServeError::Lock(_)) => Refusal::Elsewhere,
                    NotAgain::Again(AgainError::NotHomed(_)) => Refusal::PositionLost,
                    _ => Refusal::NotReady,
                };
                self.desk.refuse(why, &format!("resume of run {run} by {who} ({error})"));
                self.lock = None;
                self.desk.becomes(State::Held);
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
    ) -> Result<Again, NotAgain> {
        if self.lock.is_none() {
            self.lock = Some(self.take(journal).await?);
        }
        // Somebody may have resumed it elsewhere meanwhile: what stands in the journal now counts.
        let again = Again::of(journal.load(run).map_err(ServeError::from)?)?;
        let acknowledged = again.acknowledged(who, homed)?;
        journal.event(run, &acknowledged).await.map_err(ServeError::from)?;
        Ok(again)
    }

    pub(super) async fn measured_again(
        &self,
        again: Again,
        journal: &Journal,
    ) -> Result<(RunId, Estimate), Failed> {
        let opening = setup::devices(&again.machine, self.pace, again.past());
        let (devices, capture) = self.open(opening).await?;
        let mut progress = Progress { whole_s: 0.0, percent: 0 };
        let mut tell = |event: &Event| self.tell(event, &mut progress);
        capture.iter().for_each(|capture| capture.is_of(again.stored().summary.id));
        let readings = again.stored().readings.iter();
        let kept: BTreeSet<_> = readings.map(|reading| (reading.step, reading.repeat)).collect();
        self.desk.show(|board| board.measured = u32::try_from(kept.len()).unwrap_or(u32::MAX));
        let answers = self.desk.answers(self.patience());
        let ended = again.run(&devices, journal, answers, &mut tell).await;
        capture.into_iter().for_each(Begun::finish);
        Ok(ended?)
    }
}
