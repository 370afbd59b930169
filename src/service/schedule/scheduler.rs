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
use crate::service::machine_state::{PlannedSchedule, ServiceState};
use crate::service::not_started::NotStartedReason;
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
    required_interlocks: Vec<StartInterlock>,
    tracks: Vec<ScheduleTrack>,
    last_clock_check: Option<Timestamp>,
    readiness: Option<Readiness>,
    /// Time since which the control is known to execute no program, monotonic clock, s.
    idle_since: Option<f64>,
    idle_time: Option<Duration>,
    /// The slot whose run is in progress, and the gate's number of accepted starts at its start.
    running_slot: Option<(ScheduleSlot, u16)>,
    is_stopped: bool,
    published_minute: i64,
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
            records.record_slot_end(slot);
        }
        journal.armings(machine)?.iter().for_each(|arming| records.end_broken_arming(arming));
        let tracks = config.schedules.into_iter().zip(last_recorded);
        let tracks = tracks.map(|(entry, last_recorded)| ScheduleTrack { entry, last_recorded, waiting_slot: None });
        Ok(Self {
            tracks: tracks.collect(),
            records,
            gate,
            required_interlocks: config.required_interlocks,
            last_clock_check: None,
            readiness: None,
            idle_since: None,
            idle_time: None,
            running_slot: None,
            is_stopped: false,
            published_minute: i64::MIN,
        })
    }

    pub fn has_ended(&self) -> bool {
        self.gate.is_ending()
    }

    /// Checks all schedules once. `now`: system time; `now_s`: monotonic clock, s.
    pub fn check_schedules(&mut self, now: Timestamp, now_s: f64) {
        self.follow_running_slot();
        self.read_readiness(now_s);
        if let Some(last) = self.last_clock_check.filter(|last| now < *last) {
            self.records.log.info(&format!("schedule: the clock was set back, from {last} to {now}"));
        }
        let mut tracks = std::mem::take(&mut self.tracks);
        let mut changed = false;
        for track in &mut tracks {
            changed |= self.check_schedule(track, now);
        }
        self.tracks = tracks;
        self.last_clock_check = Some(now);
        let minute = now.as_second().div_euclid(60);
        if changed || minute != self.published_minute {
            self.published_minute = minute;
            self.publish_schedules(now);
        }
    }

    /// Processes one schedule; returns whether anything has changed.
    fn check_schedule(&mut self, track: &mut ScheduleTrack, now: Timestamp) -> bool {
        let found = find_slots(&track.entry.calendar, self.last_clock_check, track.last_recorded, now);
        let before = track.waiting_slot.clone();
        self.record_missed_slots(track, &found);
        // A waiting slot with a future time is dropped: the clock was set back, and the slot will be due again.
        track.waiting_slot = track.waiting_slot.take().filter(|(at, _)| *at <= now);
        if let Some(at) = found.due {
            if let Some((last, why)) = track.waiting_slot.take() {
                self.skip_slot(track, last, format!("{why}; the next slot is due"));
            }
            let open = at > track.last_recorded || self.records.may_slot_start(&track.entry.name, at);
            track.waiting_slot = open.then(|| (at, String::new()));
        }
        if let Some((at, why)) = track.waiting_slot.take() {
            self.decide_waiting_slot(track, at, why, now);
        }
        found.due.is_some() || !found.missed.is_empty() || before != track.waiting_slot
    }

    fn record_missed_slots(&self, track: &mut ScheduleTrack, found: &DueAndMissedSlots) {
        let ScheduleTrack { entry, last_recorded, .. } = track;
        if found.has_more_missed {
            self.records.log.info(&format!("schedule {}: earlier slots were missed as well", entry.name));
        }
        let why = match self.last_clock_check {
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

    fn decide_waiting_slot(&mut self, track: &mut ScheduleTrack, at: Timestamp, last: String, now: Timestamp) {
        let entry = &track.entry;
        let requirements = StartRequirements {
            required_interlocks: &self.required_interlocks,
            required_conditions: &entry.required_conditions,
            min_idle: entry.min_idle,
            overlap: entry.overlap,
            latest_start: at.saturating_add(entry.max_delay).unwrap_or(at),
        };
        let waiting_slot = match self.start_decision(entry.cycle, &requirements, now) {
            Ok(StartDecision::Start) => {
                let (name, cycle) = (entry.name.clone(), entry.cycle);
                track.last_recorded = track.last_recorded.max(at);
                // The reason of a failure is in the journal already.
                return drop(self.start_slot(&name, cycle, at));
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

    fn start_decision(
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
            &StartConditions {
                now,
                gate_refusal: refused,
                arming,
                readiness: self.readiness,
                idle_time: self.idle_time,
            },
        ))
    }

    /// Starts a cycle: first in the journal, then at the gate.
    fn start_slot(&mut self, schedule: &str, cycle: u16, at: Timestamp) -> Result<(), NotStartedReason> {
        let slot = self.records.new_slot(schedule, cycle, at, SlotOutcome::Started);
        if !self.records.write_slot(&slot) {
            return Err(NotStartedReason::SlotNotRecorded);
        }
        let interlocks = self.readiness.map(|readiness| readiness.interlocks).unwrap_or_default();
        match self.gate.start(cycle, interlocks, &format!("the schedule {schedule}")) {
            Ok(()) => {
                self.running_slot = Some((slot, self.gate.machine_state().accepted_starts));
                Ok(())
            }
            Err(refusal) => {
                self.records.record_not_started(schedule, cycle, at, SlotOutcome::Skipped, refusal.to_string());
                Err(refusal.into())
            }
        }
    }

    /// Handles the request of a system timer or a person that a cycle is due.
    pub fn handle_due_request(&mut self, request: DueRequest, now: Timestamp) {
        let DueRequest { cycle, who, result_sender } = request;
        self.records.log.info(&format!("schedule: {who} reports that cycle {cycle} is due"));
        // The receiver may have been dropped.
        let _ = result_sender.send(self.start_due_cycle(cycle, now));
    }

    fn start_due_cycle(&mut self, cycle: u16, now: Timestamp) -> Result<(), NotStartedReason> {
        let name = format!("{DUE_REQUEST_SCHEDULE} {cycle}");
        // The conditions of all schedules of this cycle apply.
        let of_cycle = self.tracks.iter().map(|t| &t.entry).filter(|entry| entry.cycle == cycle);
        let ready: Vec<ReadinessCondition> =
            of_cycle.clone().flat_map(|entry| entry.required_conditions.clone()).collect();
        let requirements = StartRequirements {
            required_interlocks: &self.required_interlocks,
            required_conditions: &ready,
            min_idle: of_cycle.map(|entry| entry.min_idle).max().unwrap_or_default(),
            overlap: OverlapPolicy::Skip,
            latest_start: now,
        };
        let decision = self.start_decision(cycle, &requirements, now)?;
        let began = |slot: &&ScheduleSlot| {
            let ran = !matches!(slot.outcome, SlotOutcome::Skipped | SlotOutcome::Missed);
            slot.schedule == name && ran && now.duration_since(slot.at) < REPEATED_REQUEST_WINDOW
        };
        let recent = self.records.recent_slots()?;
        let why = match (recent.iter().find(began), decision) {
            (Some(slot), _) => NotStartedReason::AlreadyStarted(slot.at),
            (None, StartDecision::Start) => return self.start_slot(&name, cycle, now),
            (None, StartDecision::Wait(why) | StartDecision::Skip(why)) => why,
        };
        self.records.record_not_started(&name, cycle, now, SlotOutcome::Skipped, why.to_string());
        Err(why)
    }

    /// Reads the machine's current readiness, and disarms all cycles when the machine is held or a cycle has failed.
    fn read_readiness(&mut self, now_s: f64) {
        self.readiness = self.gate.combined_readiness();
        let state = self.gate.machine_state().state;
        let rests = state != ServiceState::Running && self.readiness.is_some_and(|readiness| readiness.idle);
        self.idle_since = rests.then(|| self.idle_since.unwrap_or(now_s));
        self.idle_time = self.idle_since.map(|since| Duration::from_secs_f64((now_s - since).max(0.0)));
        let stopped = matches!(state, ServiceState::Held | ServiceState::Failed);
        if stopped && !self.is_stopped {
            self.records.disarm_cycles(None, "the machine is held, or a cycle failed");
        }
        self.is_stopped = stopped;
    }

    /// Follows the slot whose run is in progress, and records its end.
    fn follow_running_slot(&mut self) {
        let Some((mut slot, accepted)) = self.running_slot.take() else { return };
        let machine_state = self.gate.machine_state();
        let ours = machine_state.accepted_starts == accepted;
        if ours && slot.run == 0 && machine_state.run > 0 {
            slot.run = machine_state.run.into();
            self.records.write_slot(&slot);
        }
        match machine_state.state {
            ServiceState::Running if ours => self.running_slot = Some((slot, accepted)),
            // The next service records its outcome.
            ServiceState::Ending => {}
            _ => {
                let cycle = slot.cycle;
                if !self.records.record_slot_end(slot) {
                    self.records.disarm_cycles(None, &format!("the schedule's cycle {cycle} failed"));
                }
            }
        }
    }

    fn publish_schedules(&self, now: Timestamp) {
        let all = self.tracks.iter().map(|ScheduleTrack { entry, waiting_slot, .. }| {
            let waiting = waiting_slot.as_ref().map(|(at, why)| format!("the slot {at} waits: {why}"));
            PlannedSchedule { waiting, ..planned_schedule(entry, now) }
        });
        self.gate.update(|machine_state| machine_state.planned_schedules = all.collect());
    }
}

/// Schedules with their next times after `now`.
pub fn planned_schedules(entries: &[ScheduleEntry], now: Timestamp) -> Vec<PlannedSchedule> {
    entries.iter().map(|entry| planned_schedule(entry, now)).collect()
}

fn planned_schedule(entry: &ScheduleEntry, now: Timestamp) -> PlannedSchedule {
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
