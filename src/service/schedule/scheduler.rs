//! The scheduler: checks the clock, decides about the due slots, and executes the decision, first in the journal,
//! then at the gate.

use std::time::Duration;

use jiff::{SignedDuration, Timestamp};

use super::due_and_missed_slots::{DueAndMissedSlots, find_due_and_missed_slots};
use super::entry::{DUE_REQUEST_SCHEDULE_NAME_PREFIX, OverlapPolicy, ReadinessCondition, ScheduleEntry};
use super::slot_recorder::SlotRecorder;
use super::start_decision::{CurrentConditions, StartDecision, StartRequirements, decide_start};
use crate::service::command_gate::CommandGate;
use crate::service::config::{ServeConfig, StartInterlock};
use crate::service::machine_state::{PlannedSchedule, ServiceState};
use crate::service::not_started::NotStartedReason;
use crate::service::schedule_state::{Readiness, StartDueCycleRequest};
use crate::store::{ScheduleSlot, SlotOutcome, StoreError};

/// Time within which a report that a cycle is due counts as a repetition of the report that started the cycle. A report
/// that is earlier than that report, because the clock was set back, is a repetition as well.
const DUE_REPORT_REPETITION_TIME: SignedDuration = SignedDuration::from_mins(5);
/// Number of next times in the displayed plan.
const SHOWN_NEXT_TIME_COUNT: usize = 3;

/// A schedule of the machine file and the state of its slots.
struct TrackedSchedule {
    entry: ScheduleEntry,
    /// Time up to which the slots have an outcome in the journal; for a new schedule or a changed time pattern, the
    /// time of its registration.
    last_recorded_slot_time: Timestamp,
    /// The due slot that waits: time of the slot, and the reason why it has not started.
    waiting_slot_time_and_reason: Option<(Timestamp, String)>,
}

/// Scheduler of one machine.
pub struct Scheduler {
    slot_recorder: SlotRecorder,
    gate: CommandGate,
    /// Interlocks that `[serve]` demands.
    required_interlocks: Vec<StartInterlock>,
    tracked_schedules: Vec<TrackedSchedule>,
    /// System time of the last check; `None` before the first.
    last_clock_check: Option<Timestamp>,
    /// Combined readiness at the last check; `None` without a source, or while a source is stale.
    readiness: Option<Readiness>,
    /// Time since which the control is known to execute no program and no run of this service is in progress, monotonic
    /// clock, s; `None`: not idle, or not reported.
    idle_since_s: Option<f64>,
    /// Time since `idle_since_s` at the last check; `None`: not idle, or not reported.
    idle_time: Option<Duration>,
    /// The slot whose run is in progress, and the gate's number of accepted starts at its start.
    running_slot_and_start_count: Option<(ScheduleSlot, u16)>,
    /// Whether the machine was held or failed at the last check.
    was_held_or_failed: bool,
    /// Unix time of the last publication of the schedules, whole minutes.
    last_published_minute: i64,
}

impl Scheduler {
    /// Creates the scheduler, and records the slots that an earlier process started and the armings that are broken.
    ///
    /// # Errors
    /// The journal cannot be written.
    pub fn create_and_record_earlier_slots(
        records: SlotRecorder,
        config: ServeConfig,
        gate: CommandGate,
    ) -> Result<Self, StoreError> {
        let SlotRecorder { machine, journal, .. } = &records;
        let known = config.schedules.iter().map(|e| (e.name.clone(), format!("{} {}", e.cron_pattern, e.zone)));
        let last_recorded = journal.register_schedules(machine, known.collect(), Timestamp::now()).wait()?;
        for slot in records.recent_slots()?.into_iter().filter(|slot| slot.outcome == SlotOutcome::Started) {
            records.record_slot_outcome(slot);
        }
        journal.last_arming_of_each_cycle(machine)?.iter().for_each(|arming| records.end_broken_arming(arming));
        let tracks = config.schedules.into_iter().zip(last_recorded);
        let tracks = tracks.map(|(entry, last_recorded)| TrackedSchedule {
            entry,
            last_recorded_slot_time: last_recorded,
            waiting_slot_time_and_reason: None,
        });
        Ok(Self {
            tracked_schedules: tracks.collect(),
            slot_recorder: records,
            gate,
            required_interlocks: config.required_interlocks,
            last_clock_check: None,
            readiness: None,
            idle_since_s: None,
            idle_time: None,
            running_slot_and_start_count: None,
            was_held_or_failed: false,
            last_published_minute: i64::MIN,
        })
    }

    pub fn is_service_ending(&self) -> bool {
        self.gate.is_ending()
    }

    /// Checks all schedules once. `now`: system time; `now_s`: monotonic clock, s.
    pub fn check_schedules(&mut self, now: Timestamp, now_s: f64) {
        self.record_run_or_outcome_of_slot();
        self.read_readiness_and_disarm_if_stopped(now_s);
        if let Some(last) = self.last_clock_check.filter(|last| now < *last) {
            self.slot_recorder.log.info(&format!("schedule: the clock was set back, from {last} to {now}"));
        }
        let mut tracks = std::mem::take(&mut self.tracked_schedules);
        let mut changed = false;
        for track in &mut tracks {
            changed |= self.check_schedule(track, now);
        }
        self.tracked_schedules = tracks;
        self.last_clock_check = Some(now);
        let minute = now.as_second().div_euclid(60);
        if changed || minute != self.last_published_minute {
            self.last_published_minute = minute;
            self.publish_schedules(now);
        }
    }

    /// Processes one schedule; returns whether anything has changed.
    fn check_schedule(&mut self, track: &mut TrackedSchedule, now: Timestamp) -> bool {
        let found =
            find_due_and_missed_slots(&track.entry.calendar, self.last_clock_check, track.last_recorded_slot_time, now);
        let before = track.waiting_slot_time_and_reason.clone();
        self.record_missed_slots(track, &found);
        // A waiting slot with a future time is dropped: the clock was set back, and the slot will be due again.
        track.waiting_slot_time_and_reason = track.waiting_slot_time_and_reason.take().filter(|(at, _)| *at <= now);
        if let Some(at) = found.due {
            if let Some((last, why)) = track.waiting_slot_time_and_reason.take() {
                self.record_skipped_slot(track, last, format!("{why}; the next slot is due"));
            }
            let open = at > track.last_recorded_slot_time || self.slot_recorder.may_slot_start(&track.entry.name, at);
            track.waiting_slot_time_and_reason = open.then(|| (at, String::new()));
        }
        if let Some((at, why)) = track.waiting_slot_time_and_reason.take() {
            self.start_skip_or_keep_waiting_slot(track, at, why, now);
        }
        found.due.is_some() || !found.missed.is_empty() || before != track.waiting_slot_time_and_reason
    }

    /// Records the missed slots of `found` with their reason; its due slot is not touched.
    fn record_missed_slots(&self, track: &mut TrackedSchedule, found: &DueAndMissedSlots) {
        let TrackedSchedule { entry, last_recorded_slot_time: last_recorded, .. } = track;
        if found.has_more_missed {
            self.slot_recorder.log.info(&format!("schedule {}: earlier slots were missed as well", entry.name));
        }
        let why = match self.last_clock_check {
            None => "the service was not running at that time",
            Some(_) => "the clock was set forward past this time, or the service was suspended meanwhile",
        };
        for at in &found.missed {
            self.slot_recorder.record_not_started(&entry.name, entry.cycle, *at, SlotOutcome::Missed, why.to_owned());
            *last_recorded = *at.max(last_recorded);
        }
    }

    fn record_skipped_slot(&self, track: &mut TrackedSchedule, at: Timestamp, why: String) {
        let TrackedSchedule { entry, last_recorded_slot_time: last_recorded, .. } = track;
        self.slot_recorder.record_not_started(&entry.name, entry.cycle, at, SlotOutcome::Skipped, why);
        *last_recorded = at.max(*last_recorded);
    }

    /// Starts or skips the slot at the time `at`, or keeps it waiting. `last_reason`: why the slot has waited so far.
    fn start_skip_or_keep_waiting_slot(
        &mut self,
        track: &mut TrackedSchedule,
        at: Timestamp,
        last_reason: String,
        now: Timestamp,
    ) {
        let entry = &track.entry;
        let requirements = StartRequirements {
            required_interlocks: &self.required_interlocks,
            required_conditions: &entry.required_conditions,
            min_idle_time: entry.min_idle_time,
            overlap_policy: entry.overlap_policy,
            latest_start: at.saturating_add(entry.max_start_delay).unwrap_or(at),
        };
        let reason = match self.start_decision(entry.cycle, &requirements, now) {
            Ok(StartDecision::Start) => {
                let (name, cycle) = (entry.name.clone(), entry.cycle);
                track.last_recorded_slot_time = track.last_recorded_slot_time.max(at);
                // The reason of a failure is in the journal already.
                return drop(self.start_slot(&name, cycle, at));
            }
            Ok(StartDecision::Skip(why)) => return self.record_skipped_slot(track, at, why.to_string()),
            Ok(StartDecision::Wait(why)) => why.to_string(),
            // Without a readable journal nothing starts.
            Err(error) if now <= requirements.latest_start => format!("{error}; {}", error.remedy()),
            Err(error) => return self.record_skipped_slot(track, at, error.to_string()),
        };
        if reason != last_reason {
            self.slot_recorder.log.info(&format!("schedule {}: slot {at} waits: {reason}", entry.name));
        }
        track.waiting_slot_time_and_reason = Some((at, reason));
    }

    /// Decides whether `cycle` may start now. An arming that a run has broken is ended in the journal first.
    fn start_decision(
        &self,
        cycle: u16,
        requirements: &StartRequirements<'_>,
        now: Timestamp,
    ) -> Result<StartDecision, StoreError> {
        let armings = self.slot_recorder.journal.last_arming_of_each_cycle(&self.slot_recorder.machine)?;
        let arming = armings.iter().find(|arming| arming.cycle == cycle);
        arming.into_iter().for_each(|arming| self.slot_recorder.end_broken_arming(arming));
        let interlocks = self.readiness.map(|readiness| readiness.interlocks).unwrap_or_default();
        let gate_refusal = self.gate.check_start(cycle, interlocks).err();
        let Self { readiness, idle_time, .. } = *self;
        Ok(decide_start(requirements, &CurrentConditions { now, gate_refusal, arming, readiness, idle_time }))
    }

    /// Starts a cycle: first in the journal, then at the gate. After a refusal of the gate, the slot is recorded as
    /// skipped.
    fn start_slot(&mut self, schedule: &str, cycle: u16, at: Timestamp) -> Result<(), NotStartedReason> {
        let slot = self.slot_recorder.new_slot(schedule, cycle, at, SlotOutcome::Started);
        if !self.slot_recorder.write_slot(&slot) {
            return Err(NotStartedReason::SlotNotRecorded);
        }
        let interlocks = self.readiness.map(|readiness| readiness.interlocks).unwrap_or_default();
        match self.gate.start_cycle(cycle, interlocks, &format!("the schedule {schedule}")) {
            Ok(()) => {
                self.running_slot_and_start_count = Some((slot, self.gate.machine_state().accepted_start_count));
                Ok(())
            }
            Err(refusal) => {
                self.slot_recorder.record_not_started(schedule, cycle, at, SlotOutcome::Skipped, refusal.to_string());
                Err(refusal.into())
            }
        }
    }

    /// Starts the cycle that a system timer or a person reports as due, if the conditions of its schedules hold.
    pub fn start_cycle_reported_as_due(&mut self, request: StartDueCycleRequest, now: Timestamp) {
        let StartDueCycleRequest { cycle, who, result_sender } = request;
        self.slot_recorder.log.info(&format!("schedule: {who} reports that cycle {cycle} is due"));
        // The receiver may have been dropped.
        let _ = result_sender.send(self.start_due_cycle(cycle, now));
    }

    /// Starts `cycle` at once, or records the request as skipped; such a request never waits.
    fn start_due_cycle(&mut self, cycle: u16, now: Timestamp) -> Result<(), NotStartedReason> {
        let name = format!("{DUE_REQUEST_SCHEDULE_NAME_PREFIX} {cycle}");
        // The conditions of all schedules of this cycle apply.
        let of_cycle = self.tracked_schedules.iter().map(|t| &t.entry).filter(|entry| entry.cycle == cycle);
        let ready: Vec<ReadinessCondition> =
            of_cycle.clone().flat_map(|entry| entry.required_conditions.clone()).collect();
        let requirements = StartRequirements {
            required_interlocks: &self.required_interlocks,
            required_conditions: &ready,
            min_idle_time: of_cycle.map(|entry| entry.min_idle_time).max().unwrap_or_default(),
            overlap_policy: OverlapPolicy::Skip,
            latest_start: now,
        };
        let decision = self.start_decision(cycle, &requirements, now)?;
        let began = |slot: &&ScheduleSlot| {
            let ran = !matches!(slot.outcome, SlotOutcome::Skipped | SlotOutcome::Missed);
            slot.schedule == name && ran && now.duration_since(slot.at) < DUE_REPORT_REPETITION_TIME
        };
        let recent = self.slot_recorder.recent_slots()?;
        let why = match (recent.iter().find(began), decision) {
            (Some(slot), _) => NotStartedReason::AlreadyStarted(slot.at),
            (None, StartDecision::Start) => return self.start_slot(&name, cycle, now),
            (None, StartDecision::Wait(why) | StartDecision::Skip(why)) => why,
        };
        self.slot_recorder.record_not_started(&name, cycle, now, SlotOutcome::Skipped, why.to_string());
        Err(why)
    }

    /// Reads the machine's current readiness, and disarms all cycles once the machine is held or a cycle has failed.
    fn read_readiness_and_disarm_if_stopped(&mut self, now_s: f64) {
        self.readiness = self.gate.combined_readiness();
        let state = self.gate.machine_state().state;
        let rests = state != ServiceState::Running && self.readiness.is_some_and(|readiness| readiness.is_control_idle);
        self.idle_since_s = rests.then(|| self.idle_since_s.unwrap_or(now_s));
        self.idle_time = self.idle_since_s.map(|since| Duration::from_secs_f64((now_s - since).max(0.0)));
        let stopped = matches!(state, ServiceState::Held | ServiceState::Failed);
        if stopped && !self.was_held_or_failed {
            self.slot_recorder.disarm_cycles(None, "the machine is held, or a cycle failed");
        }
        self.was_held_or_failed = stopped;
    }

    /// Records the run number of the slot whose run is in progress, and its outcome once the run has ended. A run
    /// without an estimate disarms all cycles.
    fn record_run_or_outcome_of_slot(&mut self) {
        let Some((mut slot, accepted)) = self.running_slot_and_start_count.take() else { return };
        let machine_state = self.gate.machine_state();
        let ours = machine_state.accepted_start_count == accepted;
        if ours && slot.run == 0 && machine_state.run > 0 {
            slot.run = machine_state.run.into();
            self.slot_recorder.write_slot(&slot);
        }
        match machine_state.state {
            ServiceState::Running if ours => self.running_slot_and_start_count = Some((slot, accepted)),
            // The next process of the service records the outcome of this slot.
            ServiceState::Ending => {}
            _ => {
                let cycle = slot.cycle;
                if !self.slot_recorder.record_slot_outcome(slot) {
                    self.slot_recorder.disarm_cycles(None, &format!("the schedule's cycle {cycle} failed"));
                }
            }
        }
    }

    /// Writes the schedules with their next times to the machine state.
    fn publish_schedules(&self, now: Timestamp) {
        let all = self.tracked_schedules.iter().map(
            |TrackedSchedule { entry, waiting_slot_time_and_reason: waiting_slot, .. }| {
                let waiting = waiting_slot.as_ref().map(|(at, why)| format!("the slot {at} waits: {why}"));
                PlannedSchedule { waiting, ..planned_schedule(entry, now) }
            },
        );
        self.gate.update_machine_state(|machine_state| machine_state.planned_schedules = all.collect());
    }
}

/// Each schedule with its next due times after `now`, as many as are shown; without a waiting slot.
pub fn planned_schedules(entries: &[ScheduleEntry], now: Timestamp) -> Vec<PlannedSchedule> {
    entries.iter().map(|entry| planned_schedule(entry, now)).collect()
}

fn planned_schedule(entry: &ScheduleEntry, now: Timestamp) -> PlannedSchedule {
    PlannedSchedule {
        name: entry.name.clone(),
        cycle: entry.cycle,
        at: entry.cron_pattern.clone(),
        zone: entry.zone.clone(),
        latest_min: entry.max_start_delay.as_secs() / 60,
        next: entry.calendar.due_times_after(now).take(SHOWN_NEXT_TIME_COUNT).collect(),
        waiting: None,
    }
}
