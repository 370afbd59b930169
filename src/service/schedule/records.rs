//! Records of the schedule in the journal: the outcome of each slot, and the end of an arming.

use std::sync::Arc;

use jiff::Timestamp;

use crate::service::Log;
use crate::store::{Arming, Journal, Outcome, RunId, Slot, StoreError};

/// Number of recent slots that a query reads.
const MAX_RECENT_SLOTS: usize = 1000;
/// Name under which the program itself ends an arming.
const AUTOMATIC_DISARM_NAME: &str = "trued";

pub struct SlotRecords {
    pub machine: String,
    pub journal: Arc<Journal>,
    pub log: Log,
}

impl SlotRecords {
    pub fn slot(&self, schedule: &str, cycle: u16, at: Timestamp, outcome: Outcome) -> Slot {
        let (machine, schedule) = (self.machine.clone(), schedule.to_owned());
        Slot { machine, schedule, cycle, at, outcome, why: String::new(), run: 0 }
    }

    /// Writes the slot to the journal. Returns `false` if its outcome was decided before, or on a journal error.
    pub fn keep(&self, slot: &Slot) -> bool {
        self.journal.slot(slot).wait().unwrap_or_else(|error| {
            self.log.fault(&format!("schedule {}: {error}; {}", slot.schedule, error.remedy()));
            false
        })
    }

    /// Writes the slot as [`Self::keep`] does, and logs it.
    pub fn tell(&self, slot: &Slot) {
        if self.keep(slot) {
            let Slot { schedule, at, outcome, why, .. } = slot;
            self.log.say(&format!("schedule {schedule} of {at}: {}: {why}", outcome.as_str()));
        }
    }

    /// Recent slots, newest first.
    pub fn recent(&self) -> Result<Vec<Slot>, StoreError> {
        self.journal.slots(&self.machine, MAX_RECENT_SLOTS)
    }

    /// Whether the slot may still start: it has no outcome, or was only missed.
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

    /// Records how the run of a started slot has ended; returns whether it has a result.
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

    /// Ends the arming permanently if a run has broken it.
    pub fn end_if_broken(&self, arming: &Arming) {
        if let (None, Some(run)) = (&arming.ended, arming.broken) {
            self.disarm(Some(arming.cycle), &format!("run {run} did not come to its end"));
        }
    }

    pub fn disarm(&self, cycle: Option<u16>, why: &str) {
        match self.journal.disarm(&self.machine, cycle, AUTOMATIC_DISARM_NAME, why).wait() {
            Ok(0) => {}
            Ok(_) => self.log.say(&format!("schedule: disarmed: {why}")),
            Err(error) => self.log.fault(&format!("schedule: {error}; {}", error.remedy())),
        }
    }
}
