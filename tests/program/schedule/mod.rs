//! The schedule of the real daemon, on a clock that the test sets (`tests/peers/clock/shim.c`). Instants are UTC;
//! the UTC times of 02:30 in Berlin, 00:30 or 01:30 on these days, come from Python's zoneinfo, not from the
//! program.

mod fake_clock_and_interlocks;
mod schedule_setup;

use std::thread::sleep;
use std::time::Duration;

use serde_json::json;

use crate::support::harness::{Pool, Trials, trials};
use fake_clock_and_interlocks::READY_INTERLOCK_LINE;
use schedule_setup::{ScheduleSetup, schedule_json, start_cycle_1, wait_until_newest_slot_has_run};

fn wait_3_s() {
    sleep(Duration::from_secs(3));
}

/// Once at the first instant after the gap in spring, once at the first of both in autumn.
fn schedule_runs_once_at_each_daylight_saving_change() {
    let setup = ScheduleSetup::new("2027-03-28T00:59:00Z", "30 2 * * *", "");
    let daemon = setup.shop.start_daemon("fast");
    setup.arm();
    assert_eq!(setup.slot_times_outcomes_and_reasons().len(), 0);
    setup.clock.set_time("2027-03-28T00:59:58Z");
    setup.wait_for_single_slot("2027-03-28T01:00:00Z", "ran", "verdict pass");
    let told = schedule_json(&daemon);
    assert_eq!(told["planned"][0]["next"][0], "2027-03-29T02:30:00+02:00[Europe/Berlin]");
    assert_eq!(told["armed"][0]["who"], "Ada");
    assert_eq!(told["last"][0]["run"], 1);
    // Months later; the slots in between are missed. The jump is detected when the clock is next read.
    setup.clock.set_time("2027-10-31T00:29:50Z");
    daemon.wait_for_log("schedule dawn: slot 2027-10-30T00:30:00Z: missed: the clock was set forward");
    daemon.wait_for_log("schedule dawn: slot 2027-10-31T00:30:00Z: ran: verdict pass");
    setup.clock.set_time("2027-10-31T01:29:58Z");
    wait_3_s();
    let slots = setup.slot_times_outcomes_and_reasons();
    assert_eq!(slots[0][0], "2027-10-31T00:30:00Z", "not at the second 02:30 as well");
    assert_eq!(setup.shop.run_states(), ["finished", "finished"]);
}

fn clock_set_back_during_a_run_starts_no_second_run() {
    let setup = ScheduleSetup::new("2026-11-23T04:29:00Z", "30 5 * * *", "");
    let daemon = setup.shop.start_daemon("real");
    setup.arm();
    setup.clock.set_time("2026-11-23T04:29:58Z");
    daemon.http().wait_until_machine_state(|standing| standing["measured"].as_u64() > Some(0));
    setup.clock.set_time("2026-11-23T04:29:57Z");
    daemon.wait_for_log("the clock was set back");
    daemon.wait_for_log("schedule dawn: slot 2026-11-23T04:30:00Z is due again, but already started");
    setup.wait_for_single_slot("2026-11-23T04:30:00Z", "started", "");
    assert_eq!(setup.shop.run_states(), ["running"]);
    // The run was held: the slot failed, and the schedule is disarmed.
    assert_eq!(daemon.http().post_action("hold", &json!({})).0, 202);
    setup.wait_for_single_slot("2026-11-23T04:30:00Z", "failed", "run 1 is held");
    setup.clock.set_time("2026-11-23T04:29:57Z");
    wait_3_s();
    wait_3_s();
    assert_eq!(setup.shop.run_states(), ["held"]);
    let told = schedule_json(&daemon);
    assert!(told["armed"][0]["ended"].is_array(), "{told}");
}

fn scheduled_run_waits_for_a_manual_run_and_is_then_skipped() {
    let setup = ScheduleSetup::new("2026-11-23T04:29:00Z", "30 5 * * *", "latest_min = 10");
    let daemon = setup.shop.start_daemon("real");
    setup.arm();
    start_cycle_1(&daemon);
    setup.clock.set_time("2026-11-23T04:29:58Z");
    daemon.wait_for_log("schedule dawn: slot 2026-11-23T04:30:00Z waits: not ready: a run is in progress");
    // The page shows it a moment after it is logged.
    let waits = || schedule_json(&daemon)["planned"][0]["waiting"].as_str().map(str::to_owned);
    let told = (0..100).find_map(|_| {
        sleep(Duration::from_millis(100));
        waits()
    });
    assert!(told.is_some_and(|waiting| waiting.contains("a run is in progress")));
    setup.clock.set_time("2026-11-23T04:40:01Z");
    setup.wait_for_single_slot(
        "2026-11-23T04:30:00Z",
        "skipped",
        "the latest start time has passed: not ready: a run is in progress",
    );
    assert_eq!(setup.shop.run_states(), ["running"]);
}

fn scheduled_run_is_skipped_at_once_with_overlap_skip() {
    let setup = ScheduleSetup::new("2026-11-23T04:29:00Z", "30 5 * * *", "overlap = \"skip\"");
    let daemon = setup.shop.start_daemon("real");
    setup.arm();
    start_cycle_1(&daemon);
    setup.clock.set_time("2026-11-23T04:29:58Z");
    setup.wait_for_single_slot("2026-11-23T04:30:00Z", "skipped", "a run is in progress");
}

fn scheduled_run_waits_until_ready_and_is_skipped_after_the_limit() {
    let setup = ScheduleSetup::new("2026-11-23T04:29:00Z", "30 5 * * *", "ready = [\"artefact\"]");
    let daemon = setup.shop.start_daemon("fast");
    setup.arm();
    setup.machine.set_interlocks("TELL ENABLE AUTO");
    setup.clock.set_time("2026-11-23T04:29:58Z");
    daemon.wait_for_log("waits: not ready: a guard is open");
    setup.machine.set_interlocks(READY_INTERLOCK_LINE);
    daemon.wait_for_log("waits: not ready: the control does not report that the artefact");
    setup.machine.set_interlocks(&format!("{READY_INTERLOCK_LINE} ARTEFACT"));
    setup.wait_for_single_slot("2026-11-23T04:30:00Z", "ran", "verdict pass");
    // If the machine reports nothing within the allowed time, the slot is skipped.
    setup.machine.set_interlocks("TELL");
    setup.clock.set_time("2026-11-24T04:29:55Z");
    daemon.wait_for_log("schedule dawn: slot 2026-11-24T04:30:00Z waits");
    setup.clock.set_time("2026-11-24T05:00:01Z");
    let slots = setup.wait_for_newest_slot_outcome("skipped");
    assert!(slots[0][2].contains("latest start time has passed: not ready: the external start"), "{slots:?}");
    assert_eq!(setup.shop.run_states(), ["finished"]);
}

fn daemon_killed_at_due_time_or_in_run_does_not_repeat_the_slot() {
    let setup = ScheduleSetup::new("2026-11-23T04:29:00Z", "30 5 * * *", "");
    drop(setup.shop.start_daemon("real"));
    setup.arm();
    setup.clock.set_time("2026-11-23T04:30:05Z");
    let daemon = setup.shop.start_daemon("real");
    setup.wait_for_single_slot("2026-11-23T04:30:00Z", "missed", "the service was not running at that time");
    wait_3_s();
    assert!(setup.shop.run_states().is_empty());
    setup.clock.set_time("2026-11-24T04:29:58Z");
    daemon.http().wait_until_machine_state(|standing| standing["measured"].as_u64() > Some(0));
    wait_until_newest_slot_has_run(&daemon);
    // The daemon is killed here.
    drop(daemon);
    let daemon = setup.shop.start_daemon("real");
    daemon.wait_for_log("schedule: disarmed: run 1 was not completed");
    let slots = setup.wait_for_newest_slot_outcome("failed");
    assert_eq!((slots.len(), slots[0][0].as_str()), (2, "2026-11-24T04:30:00Z"), "{slots:?}");
    assert!(slots[0][2].contains("run 1 is interrupted"), "{slots:?}");
    setup.clock.set_time("2026-11-24T04:29:58Z");
    wait_3_s();
    wait_3_s();
    assert_eq!(setup.shop.run_states(), ["interrupted"]);
}

fn cycle_reported_as_due_must_be_armed_and_starts_once() {
    let setup = ScheduleSetup::new("2026-11-23T12:00:00Z", "30 5 * * *", "");
    let daemon = setup.shop.start_daemon("fast");
    let due = |cycle: u16| daemon.http().post_action("due", &json!({"cycle": cycle, "who": "timer"}));
    setup.machine.set_interlocks(READY_INTERLOCK_LINE);
    let (status, told) = due(1);
    assert!(status == 409 && told["message"].as_str().unwrap().contains("is not armed"), "{told}");
    let arm = |until: &str| {
        let words = json!({"cycle": 1, "who": "Ada", "until": until, "why": "over the night"});
        daemon.http().post_action("arm", &words)
    };
    assert_eq!(arm("yesterday").0, 400);
    // A second has one slot, and that one was skipped.
    wait_3_s();
    let (status, told) = arm("12h");
    let until = told["armed"][0]["until"].as_str().unwrap_or("");
    assert!(status == 202 && until.starts_with("2026-11-24T00:00"), "{told}");
    assert_eq!(due(1).0, 202);
    daemon.wait_for_log("ran: verdict pass");
    let (status, told) = due(1);
    assert!(status == 409 && told["message"].as_str().unwrap().contains("already started"), "{told}");
    let (status, told) = daemon.http().post_action("disarm", &json!({"who": "Eve"}));
    assert!(status == 202 && told["armed"][0]["ended"].is_array(), "{told}");
    setup.clock.set_time("2026-11-23T13:00:00Z");
    assert_eq!(due(1).0, 409);
    assert_eq!(setup.shop.run_states(), ["finished"]);
    let audits = setup.shop.run_json(&["schedule", schedule_setup::MACHINE_NAME, "--json"]);
    assert_eq!(audits[0]["armed"][0]["who"], "Ada");
}

pub fn trials() -> Trials {
    trials![Pool::Waiting, 30;
        schedule_runs_once_at_each_daylight_saving_change,
        scheduled_run_waits_until_ready_and_is_skipped_after_the_limit,
        clock_set_back_during_a_run_starts_no_second_run,
        daemon_killed_at_due_time_or_in_run_does_not_repeat_the_slot,
    ]
    .with_trials(trials![Pool::Waiting, 0;
        scheduled_run_waits_for_a_manual_run_and_is_then_skipped,
        scheduled_run_is_skipped_at_once_with_overlap_skip,
        cycle_reported_as_due_must_be_armed_and_starts_once,
    ])
}
