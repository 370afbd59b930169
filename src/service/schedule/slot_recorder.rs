//! Records of the schedule in the journal: the outcome of each slot, and the end of an arming.

use std::sync::Arc;

use jiff::Timestamp;

use crate::service::Log;
use crate::store::{Arming, Journal, RunId, ScheduleSlot, SlotOutcome, StoreError};

/// Number of recent slots of the machine that a query reads; older slots are not found.
const MAX_RECENT_SLOTS: usize = 1000;
/// Name under which the journal records that the program itself ended an arming.
const AUTOMATIC_DISARM_ACTOR: &str = "trued";

/// Writes the outcomes of the slots of `machine` to the journal and the log.
pub struct SlotRecorder {
    pub machine: String,
    pub journal: Arc<Journal>,
    pub log: Log,
}

impl SlotRecorder {
    /// A slot without a reason and without a run; nothing is written.
    pub fn new_slot(&self, schedule: &str, cycle: u16, at: Timestamp, outcome: SlotOutcome) -> ScheduleSlot {
        let (machine, schedule) = (self.machine.clone(), schedule.to_owned());
        ScheduleSlot { machine, schedule, cycle, at, outcome, why: String::new(), run: 0 }
    }

    /// Writes the slot to the journal. Returns `false` if an earlier outcome is kept, or on a journal error. A missed
    /// slot may still start, and a started slot gets its final outcome.
    pub fn write_slot(&self, slot: &ScheduleSlot) -> bool {
        self.journal.store_slot(slot).wait().unwrap_or_else(|error| {
            self.log.error(&format!("schedule {}: {error}; {}", slot.schedule, error.remedy()));
            false
        })
    }

    /// Writes the slot as [`Self::write_slot`] does, and logs it.
    fn write_and_log_slot(&self, slot: &ScheduleSlot) {
        if self.write_slot(slot) {
            let ScheduleSlot { schedule, at, outcome, why, .. } = slot;
            self.log.info(&format!("schedule {schedule}: slot {at}: {}: {why}", outcome.as_str()));
        }
    }

    /// Records and logs a slot that did not start.
    pub fn record_not_started(&self, schedule: &str, cycle: u16, at: Timestamp, outcome: SlotOutcome, why: String) {
        self.write_and_log_slot(&ScheduleSlot { why, ..self.new_slot(schedule, cycle, at, outcome) });
    }

    /// Recent slots, newest first.
    pub fn recent_slots(&self) -> Result<Vec<ScheduleSlot>, StoreError> {
        self.journal.newest_slots(&self.machine, MAX_RECENT_SLOTS)
    }

    /// Whether the slot may still start: it has no outcome, or was only missed. `true` also if the journal cannot be
    /// read; the start is then refused later.
    pub fn may_slot_start(&self, schedule: &str, at: Timestamp) -> bool {
        let slots = self.recent_slots().unwrap_or_default();
        let slot = slots.iter().find(|slot| slot.schedule == schedule && slot.at == at);
        match slot.filter(|slot| slot.outcome != SlotOutcome::Missed) {
            None => true,
            Some(slot) => {
                let outcome = slot.outcome.as_str();
                self.log.info(&format!("schedule {schedule}: slot {at} is due again, but already {outcome}"));
                false
            }
        }
    }

    /// Records how the run of a started slot has ended; returns whether the run has an estimate, whatever its
    /// verdict.
    pub fn record_slot_outcome(&self, slot: ScheduleSlot) -> bool {
        let stored = (slot.run > 0).then(|| self.journal.load_run(RunId(slot.run)));
        let (outcome, why) = match stored {
            None => (SlotOutcome::Failed, "the cycle ended before its run began".to_owned()),
            Some(Err(error)) => (SlotOutcome::Failed, error.to_string()),
            Some(Ok(stored)) => match stored.estimates.last() {
                Some(last) => (SlotOutcome::Ran, format!("verdict {}", last.estimate.verdict)),
                None => {
                    let state = stored.summary.state.as_str();
                    (SlotOutcome::Failed, format!("run {} is {state}, without a result", slot.run))
                }
            },
        };
        self.write_and_log_slot(&ScheduleSlot { outcome, why, ..slot });
        outcome == SlotOutcome::Ran
    }

    /// Ends the arming permanently if a run has broken it.
    pub fn end_broken_arming(&self, arming: &Arming) {
        if let (None, Some(run)) = (&arming.ended, arming.broken_by_run) {
            self.disarm_cycles(Some(arming.cycle), &format!("run {run} was not completed"));
        }
    }

    /// Disarms `cycle`, or all cycles if it is `None`.
    pub fn disarm_cycles(&self, cycle: Option<u16>, why: &str) {
        match self.journal.disarm_cycles(&self.machine, cycle, AUTOMATIC_DISARM_ACTOR, why).wait() {
            Ok(0) => {}
            Ok(_) => self.log.info(&format!("schedule: disarmed: {why}")),
            Err(error) => self.log.error(&format!("schedule: {error}; {}", error.remedy())),
        }
    }
}
