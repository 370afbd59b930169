//! The scheduler: checks the clock, decides about the due slots, and executes the decision, first in the journal,
//! then at the gate.

use std::time::Duration;

use jiff::{SignedDuration, Timestamp};

use super::entry::{DUE_REQUEST_SCHEDULE, OverlapPolicy, ReadinessCondition, ScheduleEntry};
use super::records::SlotRecorder;
use super::slot_window::{DueAndMissedSlots, find_slots};
use super::start_decision::{StartConditions, StartDecision, StartRequirements, decide_start};
use crate::service::command_gate::CommandGate;
use crate::service::config::{ServeConfig, StartInterlock};
use crate::service::machine_state::{PlannedSchedule, State};
use crate::service::not_started::NotStarted;
use crate::service::schedule_state::{DueRequest, Readiness};
use crate::store::{ScheduleSlot, SlotOutcome, StoreError};

/// Time within which a second request for a cycle counts as a repetition of the first; the same holds if the clock
/// was set back.
const REPEATED_REQUEST_WINDOW: SignedDuration = SignedDuration::from_mins(5);
/// Number of next times in the displayed plan.
const SHOWN_NEXT_TIMES: usize = 3;

struct ScheduleTrack {
    entry: ScheduleEntry,
    /// Time of the last slot that the journal has recorded.
    last_recorded: Timestamp,
    /// The due slot that waits: its time, and the reason why it has not started.
    waiting_slot: Option<(Timestamp, String)>,
}

pub struct Scheduler {
    records: SlotRecorder,
    gate: CommandGate,
    demand: Vec<StartInterlock>,
    tracks: Vec<ScheduleTrack>,
    last_check: Option<Timestamp>,
    readiness: Option<Readiness>,
    /// Time since which the control is known to execute no program, monotonic clock, s.
    idle_since: Option<f64>,
    idle: Option<Duration>,
    /// The slot whose run is in progress, and the gate's number of accepted starts at its start.
    under_way: Option<(ScheduleSlot, u16)>,
    stopped: bool,
    minute: i64,
}

impl Scheduler {
    /// Creates the scheduler, and records what an earlier service left: slots that it started, armings that are broken.
    ///
    /// # Errors
    /// The journal cannot be written.
    pub fn begin(records: SlotRecorder, config: ServeConfig, gate: CommandGate) -> Result<Self, StoreError> {
        let SlotRecorder { machine, journal, .. } = &records;
        let known = config.schedules.iter().map(|e| (e.name.clone(), format!("{} {}", e.pattern, e.zone)));
        let last_recorded = journal.register_schedules(machine, known.collect(), Timestamp::now()).wait()?;
        for slot in records.recent_slots()?.into_iter().filter(|slot| slot.outcome == SlotOutcome::Started) {
            records.record_end(slot);
        }
        journal.armings(machine)?.iter().for_each(|arming| records.end_broken_arming(arming));
        let tracks = config.schedules.into_iter().zip(last_recorded);
        let tracks = tracks.map(|(entry, last_recorded)| ScheduleTrack { entry, last_recorded, waiting_slot: None });
        Ok(Self {
            tracks: tracks.collect(),
            records,
            gate,
            demand: config.required_interlocks,
            last_check: None,
            readiness: None,
            idle_since: None,
            idle: None,
            under_way: None,
            stopped: false,
            minute: i64::MIN,
        })
    }

    pub fn has_ended(&self) -> bool {
        self.gate.is_ending()
    }

    /// Checks all schedules once. `now`: system time; `now_s`: monotonic clock, s.
    pub fn check_schedules(&mut self, now: Timestamp, now_s: f64) {
        self.track_run();
        self.read_readiness(now_s);
        if let Some(last) = self.last_check.filter(|last| now < *last) {
            self.records.log.info(&format!("schedule: the clock was set back, from {last} to {now}"));
        }
        let mut tracks = std::mem::take(&mut self.tracks);
        let mut changed = false;
        for track in &mut tracks {
            changed |= self.check_track(track, now);
        }
        self.tracks = tracks;
        self.last_check = Some(now);
        let minute = now.as_second().div_euclid(60);
        if changed || minute != self.minute {
            self.minute = minute;
            self.publish(now);
        }
    }

    /// Processes one schedule; returns whether anything has changed.
    fn check_track(&mut self, track: &mut ScheduleTrack, now: Timestamp) -> bool {
        let found = find_slots(&track.entry.calendar, self.last_check, track.last_recorded, now);
        let before = track.waiting_slot.clone();
        self.missed(track, &found);
        // A waiting slot with a future time is dropped: the clock was set back, and the slot will be due again.
        track.waiting_slot = track.waiting_slot.take().filter(|(at, _)| *at <= now);
        if let Some(at) = found.due {
            if let Some((last, why)) = track.waiting_slot.take() {
                self.skip_slot(track, last, format!("{why}; the next slot is due"));
            }
            let open = at > track.last_recorded || self.records.may_start(&track.entry.name, at);
            track.waiting_slot = open.then(|| (at, String::new()));
        }
        if let Some((at, why)) = track.waiting_slot.take() {
            self.decide(track, at, why, now);
        }
        found.due.is_some() || !found.missed.is_empty() || before != track.waiting_slot
    }

    fn missed(&self, track: &mut ScheduleTrack, found: &DueAndMissedSlots) {
        let ScheduleTrack { entry, last_recorded, .. } = track;
        if found.has_more_missed {
            self.records.log.info(&format!("schedule {}: earlier slots were missed as well", entry.name));
        }
        let why = match self.last_check {
            None => "the service was not running at that time",
            Some(_) => "the clock was set forward past the slot, or the service was suspended",
        };
        for at in &found.missed {
            self.records.record_not_started(&entry.name, entry.cycle, *at, SlotOutcome::Missed, why.to_owned());
            *last_recorded = *at.max(last_recorded);
        }
    }

    fn skip_slot(&self, track: &mut ScheduleTrack, at: Timestamp, why: String) {
        let ScheduleTrack { entry, last_recorded, .. } = track;
        self.records.record_not_started(&entry.name, entry.cycle, at, SlotOutcome::Skipped, why);
        *last_recorded = at.max(*last_recorded);
    }

    fn decide(&mut self, track: &mut ScheduleTrack, at: Timestamp, last: String, now: Timestamp) {
        let entry = &track.entry;
        let requirements = StartRequirements {
            required_interlocks: &self.demand,
            required_conditions: &entry.required_conditions,
            min_idle: entry.min_idle,
            overlap: entry.overlap,
            latest_start: at.saturating_add(entry.max_delay).unwrap_or(at),
        };
        let waiting_slot = match self.judged(entry.cycle, &requirements, now) {
            Ok(StartDecision::Start) => {
                let (name, cycle) = (entry.name.clone(), entry.cycle);
                track.last_recorded = track.last_recorded.max(at);
                // The reason of a failure is in the journal already.
                return drop(self.start(&name, cycle, at));
            }
            Ok(StartDecision::Skip(why)) => return self.skip_slot(track, at, why.to_string()),
            Ok(StartDecision::Wait(why)) => why.to_string(),
            // Without a readable journal nothing starts.
            Err(error) if now <= requirements.latest_start => {
                format!("{error}; {}", error.remedy())
            }
            Err(error) => return self.skip_slot(track, at, error.to_string()),
        };
        if waiting_slot != last {
            self.records.log.info(&format!("schedule {}: slot {at} waits: {waiting_slot}", entry.name));
        }
        track.waiting_slot = Some((at, waiting_slot));
    }

    fn judged(
        &self,
        cycle: u16,
        requirements: &StartRequirements<'_>,
        now: Timestamp,
    ) -> Result<StartDecision, StoreError> {
        let armings = self.records.journal.armings(&self.records.machine)?;
        let arming = armings.iter().find(|arming| arming.cycle == cycle);
        arming.into_iter().for_each(|arming| self.records.end_broken_arming(arming));
        let interlocks = self.readiness.map(|readiness| readiness.interlocks).unwrap_or_default();
        let refused = self.gate.check_start(cycle, interlocks).err();
        Ok(decide_start(
            requirements,
            &StartConditions { now, gate_refusal: refused, arming, readiness: self.readiness, idle_time: self.idle },
        ))
    }

    /// Starts a cycle: first in the journal, then at the gate.
    fn start(&mut self, schedule: &str, cycle: u16, at: Timestamp) -> Result<(), NotStarted> {
        let slot = self.records.new_slot(schedule, cycle, at, SlotOutcome::Started);
        if !self.records.write(&slot) {
            return Err(NotStarted::SlotNotRecorded);
        }
        let interlocks = self.readiness.map(|readiness| readiness.interlocks).unwrap_or_default();
        match self.gate.start(cycle, interlocks, &format!("the schedule {schedule}")) {
            Ok(()) => {
                self.under_way = Some((slot, self.gate.machine_state().accepted));
                Ok(())
            }
            Err(refusal) => {
                self.records.record_not_started(schedule, cycle, at, SlotOutcome::Skipped, refusal.to_string());
                Err(refusal.into())
            }
        }
    }

    /// Handles the request of a system timer or a person that a cycle is due.
    pub fn called(&mut self, call: DueRequest, now: Timestamp) {
        let DueRequest { cycle, who, answer } = call;
        self.records.log.info(&format!("schedule: {who} reports that cycle {cycle} is due"));
        // The receiver may have been dropped.
        let _ = answer.send(self.answer(cycle, now));
    }

    fn answer(&mut self, cycle: u16, now: Timestamp) -> Result<(), NotStarted> {
        let name = format!("{DUE_REQUEST_SCHEDULE} {cycle}");
        // The conditions of all schedules of this cycle apply.
        let of_cycle = self.tracks.iter().map(|t| &t.entry).filter(|entry| entry.cycle == cycle);
        let ready: Vec<ReadinessCondition> =
            of_cycle.clone().flat_map(|entry| entry.required_conditions.clone()).collect();
        let requirements = StartRequirements {
            required_interlocks: &self.demand,
            required_conditions: &ready,
            min_idle: of_cycle.map(|entry| entry.min_idle).max().unwrap_or_default(),
            overlap: OverlapPolicy::Skip,
            latest_start: now,
        };
        let decision = self.judged(cycle, &requirements, now)?;
        let began = |slot: &&ScheduleSlot| {
            let ran = !matches!(slot.outcome, SlotOutcome::Skipped | SlotOutcome::Missed);
            slot.schedule == name && ran && now.duration_since(slot.at) < REPEATED_REQUEST_WINDOW
        };
        let recent = self.records.recent_slots()?;
        let why = match (recent.iter().find(began), decision) {
            (Some(slot), _) => NotStarted::AlreadyStarted(slot.at),
            (None, StartDecision::Start) => return self.start(&name, cycle, now),
            (None, StartDecision::Wait(why) | StartDecision::Skip(why)) => why,
        };
        self.records.record_not_started(&name, cycle, now, SlotOutcome::Skipped, why.to_string());
        Err(why)
    }

    /// Reads the machine's current readiness, and disarms all cycles when the machine is held or a cycle has failed.
    fn read_readiness(&mut self, now_s: f64) {
        self.readiness = self.gate.combined_readiness();
        let state = self.gate.machine_state().state;
        let rests = state != State::Running && self.readiness.is_some_and(|readiness| readiness.idle);
        self.idle_since = rests.then(|| self.idle_since.unwrap_or(now_s));
        self.idle = self.idle_since.map(|since| Duration::from_secs_f64((now_s - since).max(0.0)));
        let stopped = matches!(state, State::Held | State::Failed);
        if stopped && !self.stopped {
            self.records.disarm(None, "the machine is held, or a cycle failed");
        }
        self.stopped = stopped;
    }

    /// Follows the slot whose run is in progress, and records its end.
    fn track_run(&mut self) {
        let Some((mut slot, accepted)) = self.under_way.take() else { return };
        let machine_state = self.gate.machine_state();
        let ours = machine_state.accepted == accepted;
        if ours && slot.run == 0 && machine_state.run > 0 {
            slot.run = machine_state.run.into();
            self.records.write(&slot);
        }
        match machine_state.state {
            State::Running if ours => self.under_way = Some((slot, accepted)),
            // The next service records its outcome.
            State::Ending => {}
            _ => {
                let cycle = slot.cycle;
                if !self.records.record_end(slot) {
                    self.records.disarm(None, &format!("the schedule's cycle {cycle} failed"));
                }
            }
        }
    }

    fn publish(&self, now: Timestamp) {
        let all = self.tracks.iter().map(|ScheduleTrack { entry, waiting_slot, .. }| {
            let waiting = waiting_slot.as_ref().map(|(at, why)| format!("the slot {at} waits: {why}"));
            PlannedSchedule { waiting, ..plan_of_entry(entry, now) }
        });
        self.gate.update(|machine_state| machine_state.planned = all.collect());
    }
}

/// Schedules with their next times after `now`.
pub fn planned(entries: &[ScheduleEntry], now: Timestamp) -> Vec<PlannedSchedule> {
    entries.iter().map(|entry| plan_of_entry(entry, now)).collect()
}

fn plan_of_entry(entry: &ScheduleEntry, now: Timestamp) -> PlannedSchedule {
    PlannedSchedule {
        name: entry.name.clone(),
        cycle: entry.cycle,
        at: entry.pattern.clone(),
        zone: entry.zone.clone(),
        latest_min: entry.max_delay.as_secs() / 60,
        next: entry.calendar.times_after(now).take(SHOWN_NEXT_TIMES).collect(),
        waiting: None,
    }
}
