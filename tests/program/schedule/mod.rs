//! The schedule of the real daemon, on a clock that the test sets (`tests/peers/clock/shim.c`). Instants are UTC;
//! the UTC times of 02:30 in Berlin, 00:30 or 01:30 on these days, come from Python's zoneinfo, not from the
//! program.

mod schedule_setup;
mod set_clock;

use std::thread::sleep;
use std::time::Duration;

use serde_json::json;

use crate::support::harness::{Pool, Trials, trials};
use schedule_setup::{ScheduleSetup, schedule, start, until_run};
use set_clock::READY;

fn a_while() {
    sleep(Duration::from_secs(3));
}

/// Once at the first instant after the gap in spring, once at the first of both in autumn.
fn daylight_saving_both_ways() {
    let setup = ScheduleSetup::new("2027-03-28T00:59:00Z", "30 2 * * *", "");
    let daemon = setup.shop.serve("fast");
    setup.arm();
    assert_eq!(setup.slots().len(), 0);
    setup.wall.set("2027-03-28T00:59:58Z");
    setup.one("2027-03-28T01:00:00Z", "ran", "verdict pass");
    let told = schedule(&daemon);
    assert_eq!(told["planned"][0]["next"][0], "2027-03-29T02:30:00+02:00[Europe/Berlin]");
    assert_eq!(told["armed"][0]["who"], "Ada");
    assert_eq!(told["last"][0]["run"], 1);
    // Months later; the slots in between are missed. The jump is detected when the clock is next read.
    setup.wall.set("2027-10-31T00:29:50Z");
    daemon.wait_for_log("schedule dawn: slot 2027-10-30T00:30:00Z: missed: the clock was set forward");
    daemon.wait_for_log("schedule dawn: slot 2027-10-31T00:30:00Z: ran: verdict pass");
    setup.wall.set("2027-10-31T01:29:58Z");
    a_while();
    let slots = setup.slots();
    assert_eq!(slots[0][0], "2027-10-31T00:30:00Z", "not at the second 02:30 as well");
    assert_eq!(setup.shop.states(), ["finished", "finished"]);
}

fn a_clock_set_back_in_mid_run() {
    let setup = ScheduleSetup::new("2026-11-23T04:29:00Z", "30 5 * * *", "");
    let daemon = setup.shop.serve("real");
    setup.arm();
    setup.wall.set("2026-11-23T04:29:58Z");
    daemon.http().wait_until(|standing| standing["measured"].as_u64() > Some(0));
    setup.wall.set("2026-11-23T04:29:57Z");
    daemon.wait_for_log("the clock was set back");
    daemon.wait_for_log("schedule dawn: slot 2026-11-23T04:30:00Z is due again, but already started");
    setup.one("2026-11-23T04:30:00Z", "started", "");
    assert_eq!(setup.shop.states(), ["running"]);
    // The run was held: the slot failed, and the schedule is disarmed.
    assert_eq!(daemon.http().post("hold", &json!({})).0, 202);
    setup.one("2026-11-23T04:30:00Z", "failed", "run 1 is held");
    setup.wall.set("2026-11-23T04:29:57Z");
    a_while();
    a_while();
    assert_eq!(setup.shop.states(), ["held"]);
    let told = schedule(&daemon);
    assert!(told["armed"][0]["ended"].is_array(), "{told}");
}

fn a_manual_run_is_on() {
    let setup = ScheduleSetup::new("2026-11-23T04:29:00Z", "30 5 * * *", "latest_min = 10");
    let daemon = setup.shop.serve("real");
    setup.arm();
    start(&daemon);
    setup.wall.set("2026-11-23T04:29:58Z");
    daemon.wait_for_log("schedule dawn: slot 2026-11-23T04:30:00Z waits: not ready: a run is in progress");
    // The page shows it a moment after it is logged.
    let waits = || schedule(&daemon)["planned"][0]["waiting"].as_str().map(str::to_owned);
    let told = (0..100).find_map(|_| {
        sleep(Duration::from_millis(100));
        waits()
    });
    assert!(told.is_some_and(|waiting| waiting.contains("a run is in progress")));
    setup.wall.set("2026-11-23T04:40:01Z");
    setup.one("2026-11-23T04:30:00Z", "skipped", "the latest start time has passed: not ready: a run is in progress");
    assert_eq!(setup.shop.states(), ["running"]);
}

fn a_manual_run_is_on_and_nobody_waits() {
    let setup = ScheduleSetup::new("2026-11-23T04:29:00Z", "30 5 * * *", "overlap = \"skip\"");
    let daemon = setup.shop.serve("real");
    setup.arm();
    start(&daemon);
    setup.wall.set("2026-11-23T04:29:58Z");
    setup.one("2026-11-23T04:30:00Z", "skipped", "a run is in progress");
}

fn a_machine_that_is_not_ready() {
    let setup = ScheduleSetup::new("2026-11-23T04:29:00Z", "30 5 * * *", "ready = [\"artefact\"]");
    let daemon = setup.shop.serve("fast");
    setup.arm();
    setup.machine.tells("TELL ENABLE AUTO");
    setup.wall.set("2026-11-23T04:29:58Z");
    daemon.wait_for_log("waits: not ready: a guard is open");
    setup.machine.tells(READY);
    daemon.wait_for_log("waits: not ready: the control does not report that the artefact");
    setup.machine.tells(&format!("{READY} ARTEFACT"));
    setup.one("2026-11-23T04:30:00Z", "ran", "verdict pass");
    // If the machine reports nothing within the allowed time, the slot is skipped.
    setup.machine.tells("TELL");
    setup.wall.set("2026-11-24T04:29:55Z");
    daemon.wait_for_log("schedule dawn: slot 2026-11-24T04:30:00Z waits");
    setup.wall.set("2026-11-24T05:00:01Z");
    let slots = setup.until("skipped");
    assert!(slots[0][2].contains("latest start time has passed: not ready: the external start"), "{slots:?}");
    assert_eq!(setup.shop.states(), ["finished"]);
}

fn the_power_goes_over_its_time_and_in_its_run() {
    let setup = ScheduleSetup::new("2026-11-23T04:29:00Z", "30 5 * * *", "");
    drop(setup.shop.serve("real"));
    setup.arm();
    setup.wall.set("2026-11-23T04:30:05Z");
    let daemon = setup.shop.serve("real");
    setup.one("2026-11-23T04:30:00Z", "missed", "the service was not running at that time");
    a_while();
    assert!(setup.shop.states().is_empty());
    setup.wall.set("2026-11-24T04:29:58Z");
    daemon.http().wait_until(|standing| standing["measured"].as_u64() > Some(0));
    until_run(&daemon);
    // The daemon is killed here.
    drop(daemon);
    let daemon = setup.shop.serve("real");
    daemon.wait_for_log("schedule: disarmed: run 1 was not completed");
    let slots = setup.until("failed");
    assert_eq!((slots.len(), slots[0][0].as_str()), (2, "2026-11-24T04:30:00Z"), "{slots:?}");
    assert!(slots[0][2].contains("run 1 is interrupted"), "{slots:?}");
    setup.wall.set("2026-11-24T04:29:58Z");
    a_while();
    a_while();
    assert_eq!(setup.shop.states(), ["interrupted"]);
}

fn a_call_that_a_cycle_is_due_is_judged_like_the_schedule() {
    let setup = ScheduleSetup::new("2026-11-23T12:00:00Z", "30 5 * * *", "");
    let daemon = setup.shop.serve("fast");
    let due = |cycle: u16| daemon.http().post("due", &json!({"cycle": cycle, "who": "timer"}));
    setup.machine.tells(READY);
    let (status, told) = due(1);
    assert!(status == 409 && told["message"].as_str().unwrap().contains("is not armed"), "{told}");
    let arm = |until: &str| {
        let words = json!({"cycle": 1, "who": "Ada", "until": until, "why": "over the night"});
        daemon.http().post("arm", &words)
    };
    assert_eq!(arm("yesterday").0, 400);
    // A second has one slot, and that one was skipped.
    a_while();
    let (status, told) = arm("12h");
    let until = told["armed"][0]["until"].as_str().unwrap_or("");
    assert!(status == 202 && until.starts_with("2026-11-24T00:00"), "{told}");
    assert_eq!(due(1).0, 202);
    daemon.wait_for_log("ran: verdict pass");
    let (status, told) = due(1);
    assert!(status == 409 && told["message"].as_str().unwrap().contains("already started"), "{told}");
    let (status, told) = daemon.http().post("disarm", &json!({"who": "Eve"}));
    assert!(status == 202 && told["armed"][0]["ended"].is_array(), "{told}");
    setup.wall.set("2026-11-23T13:00:00Z");
    assert_eq!(due(1).0, 409);
    assert_eq!(setup.shop.states(), ["finished"]);
    let audits = setup.shop.json(&["schedule", schedule_setup::NAME, "--json"]);
    assert_eq!(audits[0]["armed"][0]["who"], "Ada");
}

pub fn trials() -> Trials {
    trials![Pool::Waiting, 30;
        daylight_saving_both_ways,
        a_machine_that_is_not_ready,
        a_clock_set_back_in_mid_run,
        the_power_goes_over_its_time_and_in_its_run,
    ]
    .and(trials![Pool::Waiting, 0;
        a_manual_run_is_on,
        a_manual_run_is_on_and_nobody_waits,
        a_call_that_a_cycle_is_due_is_judged_like_the_schedule,
    ])
}
