//! Tests of the scheduler with a real gate and a real journal, on a simulated clock. The daemon's behaviour when its
//! clock is set is tested in `tests/program/schedule/`.

use std::sync::{Arc, Mutex};

use tokio::sync::mpsc::Receiver;
use tokio::sync::oneshot;

use super::entry::ScheduleEntry;
use super::scheduler::Scheduler;
use super::*;
use crate::run::RehearsalResult;
use crate::service::config::ServeConfig;
use crate::service::machine_state::{CycleEnd, Interlocks, PlannedSchedule, Refusal, ServiceState};
use crate::service::schedule_state::Readiness;
use crate::service::worker_command::WorkerCommand;
use crate::store::{Arming, SlotOutcome};

const MACHINE_NAME: &str = "the mill";

struct SchedulerFixture {
    folder: tempfile::TempDir,
    journal: Arc<Journal>,
    gate: CommandGate,
    commands: Receiver<WorkerCommand>,
    scheduler: Scheduler,
    readiness: Arc<Mutex<Readiness>>,
    /// Monotonic clock, s.
    now_s: f64,
}

fn parse_timestamp(text: &str) -> Timestamp {
    text.parse().unwrap()
}

fn dawn_schedule_entries() -> Vec<ScheduleEntry> {
    let text = "name = \"dawn\"\ncycle = 1\nat = \"30 5 * * *\"\nzone = \"Europe/Berlin\"\nidle_min = 2\n\
         ready = [\"probe\"]";
    vec![toml::from_str(text).unwrap()]
}

fn serve_config() -> ServeConfig {
    toml::from_str(
        "min_interval_s = 0.0\n[[cycle]]\nnumber = 1\nmethod = \"self-calibration\"\n\
         [http]\nlisten = \"127.0.0.1:0\"\n",
    )
    .unwrap()
}

fn sufficient_readiness() -> Readiness {
    let interlocks = Interlocks {
        is_fresh: true,
        is_start_enabled: true,
        is_auto_mode: true,
        is_door_closed: true,
        is_stop_set: false,
        has_person_for_prompts: false,
    };
    Readiness { interlocks, is_control_idle: true, is_probe_ready: true, ..Readiness::default() }
}

/// A new service on the journal in `folder`. `known_since`: time since which its schedule is known.
fn open_scheduler(folder: tempfile::TempDir, known_since: Option<&str>) -> SchedulerFixture {
    let journal = Arc::new(Journal::open(folder.path()).unwrap());
    if let Some(since) = known_since {
        let known = vec![("dawn".to_owned(), "30 5 * * * Europe/Berlin".to_owned())];
        journal.register_schedules(MACHINE_NAME, known, parse_timestamp(since)).wait().unwrap();
    }
    let log: Log = Log::new(|_, _| {});
    let (gate, commands) = CommandGate::new(&serve_config(), log.clone());
    gate.finish_command(ServiceState::Waiting);
    let readiness = Arc::new(Mutex::new(sufficient_readiness()));
    let source = Arc::clone(&readiness);
    gate.add_readiness_source(move || *source.lock().unwrap());
    let records = SlotRecorder { machine: MACHINE_NAME.to_owned(), journal: Arc::clone(&journal), log };
    let config = ServeConfig { schedules: dawn_schedule_entries(), ..serve_config() };
    let scheduler = Scheduler::create_and_record_earlier_slots(records, config, gate.clone()).unwrap();
    SchedulerFixture { folder, journal, gate, commands, scheduler, readiness, now_s: 0.0 }
}

/// A scheduler whose cycle is armed for a week from 22 November 2026 and due each day at 04:30 UTC.
fn armed_scheduler() -> SchedulerFixture {
    let bench = open_scheduler(tempfile::tempdir().unwrap(), Some("2026-11-22T12:00:00Z"));
    bench.arm_for_a_week("2026-11-22T12:00:00Z");
    bench
}

impl SchedulerFixture {
    fn arm_for_a_week(&self, armed: &str) {
        let armed = parse_timestamp(armed);
        let arming = Arming {
            machine: MACHINE_NAME.to_owned(),
            cycle: 1,
            who: "Ada".to_owned(),
            why: String::new(),
            armed,
            until: armed + jiff::SignedDuration::from_hours(168),
            ended: None,
            broken_by_run: None,
        };
        self.journal.arm_cycle(&arming).wait().unwrap();
    }

    /// Checks every 30 s of both clocks, starting at `from`.
    fn check_every_30_s(&mut self, from: &str, times: i32) {
        for step in 0..times {
            let now = parse_timestamp(from) + jiff::SignedDuration::from_secs((30 * step).into());
            self.now_s += 30.0;
            self.scheduler.check_schedules(now, self.now_s);
        }
    }

    fn take_start_count(&mut self) -> usize {
        std::iter::from_fn(|| self.commands.try_recv().ok())
            .filter(|ask| matches!(ask, WorkerCommand::StartCycle { .. }))
            .count()
    }

    fn recorded_slots(&self) -> Vec<(String, SlotOutcome, String)> {
        let slots = self.journal.newest_slots(MACHINE_NAME, 100).unwrap().into_iter();
        slots.map(|slot| (slot.at.to_string()[8..16].to_owned(), slot.outcome, slot.why)).collect()
    }

    fn assert_only_slot(&self, day_and_time: &str, outcome: SlotOutcome, why: &str) {
        let slots = self.recorded_slots();
        let [(at, became, words)] = slots.as_slice() else { panic!("{slots:?}") };
        assert!((at.as_str(), *became) == (day_and_time, outcome) && words.contains(why), "{slots:?}");
    }

    /// Simulates a power cut and a restart.
    fn restart_after_power_cut(self) -> Self {
        let Self { folder, journal, scheduler, gate, .. } = self;
        drop((scheduler, gate, journal));
        open_scheduler(folder, None)
    }

    fn published_schedule(&self) -> PlannedSchedule {
        self.gate.machine_state().planned_schedules.remove(0)
    }
}

#[test]
fn due_armed_and_ready_slot_starts_once() {
    let mut bench = armed_scheduler();
    bench.check_every_30_s("2026-11-23T04:20:00Z", 21);
    assert_eq!(bench.published_schedule().next[0].to_string(), "2026-11-24T05:30:00+01:00[Europe/Berlin]");
    assert_eq!(bench.take_start_count(), 1);
    bench.assert_only_slot("23T04:30", SlotOutcome::Started, "");
    bench.check_every_30_s("2026-11-23T04:30:30Z", 10);
    assert_eq!(bench.take_start_count(), 0);
    // The cycle failed before its run began: nothing starts until it is armed again.
    bench.gate.record_cycle_end(CycleEnd::in_state(ServiceState::Failed));
    bench.check_every_30_s("2026-11-23T04:36:00Z", 1);
    bench.assert_only_slot("23T04:30", SlotOutcome::Failed, "before its run began");
    bench.gate.finish_command(ServiceState::Waiting);
    bench.check_every_30_s("2026-11-24T04:25:00Z", 20);
    assert_eq!(bench.take_start_count(), 0);
    let slots = bench.recorded_slots();
    assert!(slots[0].1 == SlotOutcome::Skipped && slots[0].2.contains("the schedule's cycle 1 failed"), "{slots:?}");
    let audits = bench.journal.audit_entries(None, 1).unwrap();
    assert_eq!(audits[0].entry.what, "cycle 1 is disarmed");
}

#[test]
fn unarmed_slot_does_not_start() {
    let mut bench = open_scheduler(tempfile::tempdir().unwrap(), Some("2026-11-22T12:00:00Z"));
    bench.check_every_30_s("2026-11-23T04:20:00Z", 21);
    bench.assert_only_slot("23T04:30", SlotOutcome::Skipped, "is not armed");
    // An arming after the slot's time starts nothing.
    bench.arm_for_a_week("2026-11-23T04:31:00Z");
    bench.check_every_30_s("2026-11-23T04:31:00Z", 60);
    assert_eq!((bench.take_start_count(), bench.recorded_slots().len()), (0, 1));
}

#[test]
fn unready_slot_waits_and_is_skipped_after_its_latest_start() {
    let mut bench = armed_scheduler();
    bench.readiness.lock().unwrap().interlocks.is_door_closed = false;
    bench.check_every_30_s("2026-11-23T04:20:00Z", 40);
    assert_eq!(bench.recorded_slots(), [], "the slot waits");
    assert!(bench.published_schedule().waiting.unwrap().contains("a guard is open"));
    bench.check_every_30_s("2026-11-23T04:40:00Z", 50);
    bench.assert_only_slot(
        "23T04:30",
        SlotOutcome::Skipped,
        "latest start time has passed: not ready: a guard is open",
    );
    bench.readiness.lock().unwrap().interlocks.is_door_closed = true;
    bench.check_every_30_s("2026-11-23T05:05:00Z", 20);
    assert_eq!(bench.take_start_count(), 0);
    // The next day, the door closes ten minutes after the slot's time; the machine has been idle before.
    bench.readiness.lock().unwrap().interlocks.is_door_closed = false;
    bench.check_every_30_s("2026-11-24T04:29:00Z", 20);
    bench.readiness.lock().unwrap().interlocks.is_door_closed = true;
    bench.check_every_30_s("2026-11-24T04:39:00Z", 1);
    assert_eq!(bench.take_start_count(), 1);
}

#[test]
fn slot_waits_until_the_control_is_idle_long_enough() {
    let mut bench = armed_scheduler();
    bench.check_every_30_s("2026-11-23T04:20:00Z", 19);
    bench.readiness.lock().unwrap().is_control_idle = false;
    bench.check_every_30_s("2026-11-23T04:29:30Z", 2);
    bench.readiness.lock().unwrap().is_control_idle = true;
    bench.check_every_30_s("2026-11-23T04:30:30Z", 4);
    assert_eq!(bench.take_start_count(), 0, "the control was idle for only a minute and a half");
    assert!(bench.published_schedule().waiting.unwrap().contains("idle for 1 of 2 minutes"));
    bench.check_every_30_s("2026-11-23T04:32:30Z", 1);
    assert_eq!(bench.take_start_count(), 1);
    // Without a report, the conditions do not hold.
    let mut silent = self::armed_scheduler();
    silent.readiness.lock().unwrap().interlocks.is_fresh = false;
    silent.check_every_30_s("2026-11-23T04:20:00Z", 100);
    silent.assert_only_slot("23T04:30", SlotOutcome::Skipped, "no current report of enable, auto, door, probe, idle");
}

#[test]
fn slot_waits_for_the_end_of_a_manual_run() {
    let mut bench = armed_scheduler();
    bench.gate.start_cycle(1, sufficient_readiness().interlocks, "Ada").unwrap();
    assert_eq!(bench.take_start_count(), 1);
    bench.check_every_30_s("2026-11-23T04:20:00Z", 40);
    assert_eq!(bench.take_start_count(), 0);
    assert!(bench.published_schedule().waiting.unwrap().contains("a run is in progress"));
    bench.gate.record_cycle_end(CycleEnd::in_state(ServiceState::Waiting));
    bench.check_every_30_s("2026-11-23T04:40:00Z", 6);
    assert_eq!(bench.take_start_count(), 1, "the cycle starts two minutes after the end of the run");
    bench.assert_only_slot("23T04:30", SlotOutcome::Started, "");
}

#[test]
fn clock_set_back_during_a_run_starts_nothing_twice() {
    let mut bench = armed_scheduler();
    bench.check_every_30_s("2026-11-23T04:20:00Z", 24);
    assert_eq!(bench.take_start_count(), 1);
    bench.check_every_30_s("2026-11-23T04:10:00Z", 30);
    bench.gate.record_cycle_end(CycleEnd::in_state(ServiceState::Waiting));
    bench.check_every_30_s("2026-11-23T04:25:00.4Z", 30);
    assert_eq!(bench.take_start_count(), 0);
    bench.assert_only_slot("23T04:30", SlotOutcome::Failed, "before its run began");
    // The same holds after a power cut.
    let mut bench = bench.restart_after_power_cut();
    bench.arm_for_a_week("2026-11-22T12:00:00Z");
    bench.check_every_30_s("2026-11-23T04:10:00.4Z", 60);
    assert_eq!((bench.take_start_count(), bench.recorded_slots().len()), (0, 1));
}

#[test]
fn a_slot_that_was_missed_by_a_wrong_clock_runs_when_its_time_comes() {
    let mut bench = armed_scheduler();
    bench.check_every_30_s("2026-11-23T04:20:00Z", 2);
    bench.check_every_30_s("2026-11-23T06:00:00Z", 1);
    bench.assert_only_slot("23T04:30", SlotOutcome::Missed, "the clock was set forward");
    assert_eq!(bench.take_start_count(), 0);
    bench.check_every_30_s("2026-11-23T04:22:00.4Z", 20);
    assert_eq!(bench.take_start_count(), 1);
    bench.assert_only_slot("23T04:30", SlotOutcome::Started, "");
}

#[test]
fn slot_hit_by_a_power_cut_is_missed_or_failed_and_not_run_later() {
    let mut bench = armed_scheduler();
    bench.check_every_30_s("2026-11-23T04:20:00Z", 2);
    let mut bench = bench.restart_after_power_cut();
    bench.check_every_30_s("2026-11-23T04:30:10Z", 60);
    assert_eq!(bench.take_start_count(), 0);
    bench.assert_only_slot("23T04:30", SlotOutcome::Missed, "the service was not running");
    // A power cut during the run that the schedule started: it is recorded as failed and not run again.
    bench.check_every_30_s("2026-11-24T04:25:00Z", 12);
    assert_eq!(bench.take_start_count(), 1);
    let mut bench = bench.restart_after_power_cut();
    bench.check_every_30_s("2026-11-24T04:31:00Z", 60);
    assert_eq!(bench.take_start_count(), 0);
    let slots = bench.recorded_slots();
    assert_eq!((slots.len(), slots[0].1), (2, SlotOutcome::Failed), "{slots:?}");
}

#[test]
fn cycle_reported_as_due_needs_the_slot_conditions_and_starts_once() {
    let mut bench = armed_scheduler();
    let report_due = |bench: &mut SchedulerFixture, now: &str| {
        bench.now_s += 70.0;
        bench.scheduler.check_schedules(parse_timestamp(now), bench.now_s);
        let (result_sender, mut result_receiver) = oneshot::channel();
        bench.scheduler.start_cycle_reported_as_due(
            StartDueCycleRequest { cycle: 1, who: "timer".to_owned(), result_sender },
            parse_timestamp(now),
        );
        result_receiver.try_recv().unwrap().map_err(|why| why.to_string())
    };
    bench.readiness.lock().unwrap().interlocks.is_auto_mode = false;
    let refused = report_due(&mut bench, "2026-11-23T04:00:00.3Z").unwrap_err();
    assert!(refused.contains("automatic mode"), "{refused}");
    bench.readiness.lock().unwrap().interlocks.is_auto_mode = true;
    // The conditions of the cycle's schedules apply to a request too.
    bench.readiness.lock().unwrap().is_probe_ready = false;
    let refused = report_due(&mut bench, "2026-11-23T04:00:10Z").unwrap_err();
    assert!(refused.contains("probe"), "{refused}");
    bench.readiness.lock().unwrap().is_probe_ready = true;
    bench.now_s -= 60.0;
    let refused = report_due(&mut bench, "2026-11-23T04:00:20Z").unwrap_err();
    assert!(refused.contains("idle for 1 of 2"), "{refused}");
    assert_eq!(report_due(&mut bench, "2026-11-23T04:01:00.7Z"), Ok(()));
    assert_eq!(bench.take_start_count(), 1);
    bench.gate.record_cycle_end(CycleEnd::in_state(ServiceState::Waiting));
    bench.arm_for_a_week("2026-11-22T12:00:00Z");
    // The clock is set back, and the timer expires again.
    for now in ["2026-11-23T03:50:00Z", "2026-11-23T04:00:59Z", "2026-11-23T04:05:59Z"] {
        let refused = report_due(&mut bench, now).unwrap_err();
        assert!(refused.contains("already started"), "{refused}");
    }
    let outcomes: Vec<_> = bench.recorded_slots().into_iter().map(|(_, outcome, _)| outcome).collect();
    assert_eq!(outcomes.iter().filter(|outcome| **outcome == SlotOutcome::Skipped).count(), 6);
    bench.arm_for_a_week("2026-11-22T12:00:00Z");
    assert_eq!(report_due(&mut bench, "2026-11-23T04:07:00Z"), Ok(()));
}

/// A cycle with a prompt starts neither by the schedule nor by a trigger; a person at the page may start it.
#[test]
fn cycle_with_prompts_does_not_start_unattended() {
    let mut bench = armed_scheduler();
    bench.gate.set_rehearsal_results([(1, RehearsalResult { machine_time_s: 60.0, has_prompts: true })].into());
    bench.check_every_30_s("2026-11-23T04:20:00Z", 30);
    assert_eq!(bench.take_start_count(), 0);
    let last = bench.journal.newest_slots(MACHINE_NAME, 1).unwrap().remove(0);
    assert!(last.outcome == SlotOutcome::Skipped && last.why.contains("has prompts"), "{last:?}");
    assert_eq!(bench.gate.start_cycle(1, sufficient_readiness().interlocks, "a button"), Err(Refusal::PlanHasPrompts));
    bench
        .gate
        .start_cycle(1, Interlocks { has_person_for_prompts: true, ..sufficient_readiness().interlocks }, "Ada")
        .unwrap();
    assert_eq!(bench.take_start_count(), 1);
}
