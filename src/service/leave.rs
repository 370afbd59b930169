//! A held machine: a person leaves the run as it is, or another program goes on with it.

use super::ServeError;
use super::ask::Word;
use super::attend::Attendant;
use super::board::{Refusal, State};
use super::past::{last_of, unfinished};
use crate::store::{Journal, MachineLock};
use machine::record::event::Event;

impl Attendant {
    /// A person at the machine has acknowledged. That lets a new cycle start; it does not resume.
    pub(super) async fn acknowledged(&mut self, word: Word, journal: &Journal) {
        let cleared = self.clear(&word, journal).await;
        let refused = match cleared {
            Ok(None) => {
                self.desk.show(|board| board.failure = None);
                self.desk.becomes(State::Waiting);
                self.log.say("acknowledged; ready");
                None
            }
            Ok(Some(why)) => Some((why, String::new())),
            Err(ServeError::Lock(error)) => Some((Refusal::Elsewhere, format!(" ({error})"))),
            Err(error) => Some((Refusal::NotReady, format!(" ({error})"))),
        };
        if let Some((why, because)) = &refused {
            let before = self.desk.board().state;
            if before == State::Held {
                self.lock = None;
            }
            self.desk.refuse(*why, &format!("acknowledgement by {}{because}", word.who));
            self.desk.becomes(before);
        }
        // Nobody may wait for it.
        let _ = word.answer.send(refused.map_or(Ok(()), |(why, _)| Err(why)));
    }

    async fn clear(
        &mut self,
        Word { who, why, homed, .. }: &Word,
        journal: &Journal,
    ) -> Result<Option<Refusal>, ServeError> {
        match self.lock {
            None => self.lock = Some(self.take(journal).await?),
            Some(_) => self.find_unidentified(journal)?,
        }
        let Some(before) = unfinished(journal, self.name())? else { return Ok(None) };
        if before.position_lost && !homed {
            return Ok(Some(Refusal::PositionLost));
        }
        let homed = if *homed { ", all axes are homed" } else { "" };
        let why = if why.is_empty() { String::new() } else { format!(" ({why})") };
        let what = format!("it is left as it is{homed}; new cycles may start{why}");
        let word = Event::Acknowledged { who: who.clone(), what, leaves: true };
        journal.event(before.run, &word).await?;
        Ok(None)
    }

    /// While the machine is held anybody may go on with its run elsewhere: the board says so, and what became
    /// of it.
    pub(super) async fn look_elsewhere(&mut self, journal: &Journal) {
        let board = self.desk.board();
        if self.lock.is_some() || board.state != State::Held {
            return;
        }
        let elsewhere = MachineLock::holder(&self.folder, self.name()).is_some();
        if elsewhere != board.elsewhere {
            self.desk.show(|board| board.elsewhere = elsewhere);
        }
        let last = last_of(journal, self.name()).ok().flatten();
        let changed = last.is_some_and(|run| !run.state.is_resumable());
        if !elsewhere && (board.elsewhere || changed) {
            self.see_what_became(journal).await;
        }
    }

    /// Taken first: only then is a run whose process died known as interrupted.
    async fn see_what_became(&mut self, journal: &Journal) {
        // Taken by the next one meanwhile: that is seen at the next look.
        let Ok(lock) = self.take(journal).await else { return };
        match unfinished(journal, self.name()) {
            Ok(None) => {
                self.lock = Some(lock);
                if self.desk.rests(State::Waiting) {
                    self.desk.show(|board| board.failure = None);
                    self.log.say("the run was seen to elsewhere; ready");
                }
            }
            Ok(Some(before)) => self.desk.show(|board| board.failure = Some(before.why)),
            Err(error) => self.log.fault(&error.to_string()),
        }
    }
}
