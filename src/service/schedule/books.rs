//! What the schedule writes down: what became of each slot, and the end of an arming.

use std::sync::Arc;

use jiff::Timestamp;

use crate::service::Log;
use crate::store::{Arming, Journal, Outcome, RunId, Slot, StoreError};

/// Of the journal's slots that one looks through.
const RECENT: usize = 1000;
/// Who ends an arming that nobody ended.
const SELF: &str = "trued";

pub struct Books {
    pub machine: String,
    pub journal: Arc<Journal>,
    pub log: Log,
}

impl Books {
    pub fn slot(&self, schedule: &str, cycle: u16, at: Timestamp, outcome: Outcome) -> Slot {
        let (machine, schedule) = (self.machine.clone(), schedule.to_owned());
        Slot { machine, schedule, cycle, at, outcome, why: String::new(), run: 0 }
    }

    /// Whether it is written down now; it is not, where it was decided before.
    pub fn keep(&self, slot: &Slot) -> bool {
        self.journal.slot(slot).wait().unwrap_or_else(|error| {
            self.log.fault(&format!("schedule {}: {error}; {}", slot.schedule, error.remedy()));
            false
        })
    }

    /// The same, and say so.
    pub fn tell(&self, slot: &Slot) {
        if self.keep(slot) {
            let Slot { schedule, at, outcome, why, .. } = slot;
            self.log.say(&format!("schedule {schedule} of {at}: {}: {why}", outcome.as_str()));
        }
    }

    /// Newest first.
    pub fn recent(&self) -> Result<Vec<Slot>, StoreError> {
        self.journal.slots(&self.machine, RECENT)
    }

    /// Whether nothing became of it yet that stands.
    pub fn is_open(&self, schedule: &str, at: Timestamp) -> bool {
        let slots = self.recent().unwrap_or_default();
        let slot = slots.iter().find(|slot| slot.schedule == schedule && slot.at == at);
        match slot.filter(|slot| slot.outcome != Outcome::Missed) {
            None => true,
            Some(slot) => {
                let outcome = slot.outcome.as_str();
                self.log
                    .say(&format!("schedule {schedule} of {at} comes again; it {outcome} already"));
                false
            }
        }
    }

    /// How the run of a slot that was started has ended; whether well.
    pub fn settle(&self, slot: Slot) -> bool {
        let stored = (slot.run > 0).then(|| self.journal.load(RunId(slot.run)));
        let (outcome, why) = match stored {
            None => (Outcome::Failed, "it ended before it had a run".to_owned()),
            Some(Err(error)) => (Outcome::Failed, error.to_string()),
            Some(Ok(stored)) => match stored.estimates.last() {
                Some(last) => (Outcome::Ran, format!("verdict {}", last.estimate.verdict)),
                None => {
                    let state = stored.summary.state.as_str();
                    (Outcome::Failed, format!("run {} is {state}, without a result", slot.run))
                }
            },
        };
        self.tell(&Slot { outcome, why, ..slot });
        outcome == Outcome::Ran
    }

    /// An arming that a run has broken ends for good.
    pub fn end_if_broken(&self, arming: &Arming) {
        if let (None, Some(run)) = (&arming.ended, arming.broken) {
            self.disarm(Some(arming.cycle), &format!("run {run} did not come to its end"));
        }
    }

    pub fn disarm(&self, cycle: Option<u16>, why: &str) {
        match self.journal.disarm(&self.machine, cycle, SELF, why).wait() {
            Ok(0) => {}
            Ok(_) => self.log.say(&format!("schedule: disarmed: {why}")),
            Err(error) => self.log.fault(&format!("schedule: {error}; {}", error.remedy())),
        }
    }
}
