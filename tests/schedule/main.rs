//! The schedule of the real daemon, on a clock that is set under it (`tests/peers/clock/shim.c`). Instants
//! are those of UTC; that 02:30 in Berlin is 00:30 or 01:30 on these days is known from Python's zoneinfo,
//! not from the program.

mod bench;
#[path = "../serve/shop.rs"]
#[allow(dead_code)]
mod shop;
#[path = "../support/waiting.rs"]
mod waiting;
mod wall;

use std::thread::sleep;
use std::time::Duration;

use serde_json::{Value, json};

use bench::{Bench, ask, said, stands, start, until_run};
use waiting::named;
use wall::READY;

fn a_while() {
    sleep(Duration::from_secs(3));
}

/// Once at the first instant after the gap in spring, once at the first of both in autumn.
fn daylight_saving_both_ways() {
    let bench = Bench::new("2027-03-28T00:59:00Z", "30 2 * * *", "");
    let daemon = bench.shop.serve("fast");
    bench.arm();
    assert_eq!(bench.slots().len(), 0);
    bench.wall.set("2027-03-28T00:59:58Z");
    bench.one("2027-03-28T01:00:00Z", "ran", "verdict pass");
    let told = ask(&daemon, "GET", "/schedule", &Value::Null).1;
    assert_eq!(told["planned"][0]["next"][0], "2027-03-29T02:30:00+02:00[Europe/Berlin]");
    assert_eq!(told["armed"][0]["who"], "Ada");
    assert_eq!(told["last"][0]["run"], 1);
    // Months later; what lies between is missed. No sooner than the clock was looked at again.
    bench.wall.set("2027-10-31T00:29:50Z");
    said(&daemon, "schedule dawn of 2027-10-30T00:30:00Z: missed: the clock went forward");
    said(&daemon, "schedule dawn of 2027-10-31T00:30:00Z: ran: verdict pass");
    bench.wall.set("2027-10-31T01:29:58Z");
    a_while();
    let slots = bench.slots();
    assert_eq!(slots[0][0], "2027-10-31T00:30:00Z", "not at the second 02:30 as well");
    assert_eq!(bench.shop.states(), ["finished", "finished"]);
}

fn a_clock_set_back_in_mid_run() {
    let bench = Bench::new("2026-11-23T04:29:00Z", "30 5 * * *", "");
    let daemon = bench.shop.serve("real");
    bench.arm();
    bench.wall.set("2026-11-23T04:29:58Z");
    stands(&daemon, |standing| standing["measured"].as_u64() > Some(0));
    bench.wall.set("2026-11-23T04:29:57Z");
    said(&daemon, "the clock was set back");
    said(&daemon, "schedule dawn of 2026-11-23T04:30:00Z comes again; it started already");
    bench.one("2026-11-23T04:30:00Z", "started", "");
    assert_eq!(bench.shop.states(), ["running"]);
    // Held: so it failed, and nothing is armed any more.
    assert_eq!(ask(&daemon, "POST", "/hold", &json!({})).0, 202);
    bench.one("2026-11-23T04:30:00Z", "failed", "run 1 is held");
    bench.wall.set("2026-11-23T04:29:57Z");
    a_while();
    a_while();
    assert_eq!(bench.shop.states(), ["held"]);
    let told = ask(&daemon, "GET", "/schedule", &Value::Null).1;
    assert!(told["armed"][0]["ended"].is_array(), "{told}");
}

fn a_manual_run_is_on() {
    let bench = Bench::new("2026-11-23T04:29:00Z", "30 5 * * *", "latest_min = 10");
    let daemon = bench.shop.serve("real");
    bench.arm();
    start(&daemon);
    bench.wall.set("2026-11-23T04:29:58Z");
    said(&daemon, "schedule dawn of 2026-11-23T04:30:00Z waits: not ready: a run is on");
    let told = ask(&daemon, "GET", "/schedule", &Value::Null).1;
    assert!(told["planned"][0]["waiting"].as_str().unwrap().contains("a run is on"), "{told}");
    bench.wall.set("2026-11-23T04:40:01Z");
    bench.one(
        "2026-11-23T04:30:00Z",
        "skipped",
        "its latest start is over: not ready: a run is on",
    );
    assert_eq!(bench.shop.states(), ["running"]);
}

fn a_manual_run_is_on_and_nobody_waits() {
    let bench = Bench::new("2026-11-23T04:29:00Z", "30 5 * * *", "overlap = \"skip\"");
    let daemon = bench.shop.serve("real");
    bench.arm();
    start(&daemon);
    bench.wall.set("2026-11-23T04:29:58Z");
    bench.one("2026-11-23T04:30:00Z", "skipped", "a run is on");
}

fn a_machine_that_is_not_ready() {
    let bench = Bench::new("2026-11-23T04:29:00Z", "30 5 * * *", "ready = [\"artefact\"]");
    let daemon = bench.shop.serve("fast");
    bench.arm();
    bench.machine.tells("TELL ENABLE AUTO");
    bench.wall.set("2026-11-23T04:29:58Z");
    said(&daemon, "waits: not ready: a guard is open");
    bench.machine.tells(READY);
    said(&daemon, "waits: not ready: the machine does not tell that the artefact");
    bench.machine.tells(&format!("{READY} ARTEFACT"));
    bench.one("2026-11-23T04:30:00Z", "ran", "verdict pass");
    // What it does not tell at all within the time that is granted is skipped.
    bench.machine.tells("TELL");
    bench.wall.set("2026-11-24T04:29:55Z");
    said(&daemon, "schedule dawn of 2026-11-24T04:30:00Z waits");
    bench.wall.set("2026-11-24T05:00:01Z");
    let slots = bench.until("skipped");
    assert!(
        slots[0][2].contains("latest start is over: not ready: the external start"),
        "{slots:?}"
    );
    assert_eq!(bench.shop.states(), ["finished"]);
}

fn the_power_goes_over_its_time_and_in_its_run() {
    let bench = Bench::new("2026-11-23T04:29:00Z", "30 5 * * *", "");
    drop(bench.shop.serve("real"));
    bench.arm();
    bench.wall.set("2026-11-23T04:30:05Z");
    let daemon = bench.shop.serve("real");
    bench.one("2026-11-23T04:30:00Z", "missed", "no service was there at its time");
    a_while();
    assert!(bench.shop.states().is_empty());
    bench.wall.set("2026-11-24T04:29:58Z");
    stands(&daemon, |standing| standing["measured"].as_u64() > Some(0));
    until_run(&daemon);
    // It is killed here.
    drop(daemon);
    let daemon = bench.shop.serve("real");
    said(&daemon, "schedule: disarmed: run 1 did not come to its end");
    let slots = bench.until("failed");
    assert_eq!((slots.len(), slots[0][0].as_str()), (2, "2026-11-24T04:30:00Z"), "{slots:?}");
    assert!(slots[0][2].contains("run 1 is interrupted"), "{slots:?}");
    bench.wall.set("2026-11-24T04:29:58Z");
    a_while();
    a_while();
    assert_eq!(bench.shop.states(), ["interrupted"]);
}

fn a_call_that_a_cycle_is_due_is_judged_like_the_schedule() {
    let bench = Bench::new("2026-11-23T12:00:00Z", "30 5 * * *", "");
    let daemon = bench.shop.serve("fast");
    let due = |cycle: u16| ask(&daemon, "POST", "/due", &json!({"cycle": cycle, "who": "timer"}));
    bench.machine.tells(READY);
    let (status, told) = due(1);
    assert!(
        status == 409 && told["message"].as_str().unwrap().contains("nobody has armed"),
        "{told}"
    );
    let arm = |until: &str| {
        let words = json!({"cycle": 1, "who": "Ada", "until": until, "why": "over the night"});
        ask(&daemon, "POST", "/arm", &words)
    };
    assert_eq!(arm("yesterday").0, 400);
    // Of one second there is one slot, and that was skipped.
    a_while();
    let (status, told) = arm("12h");
    let until = told["armed"][0]["until"].as_str().unwrap_or("");
    assert!(status == 202 && until.starts_with("2026-11-24T00:00"), "{told}");
    assert_eq!(due(1).0, 202);
    said(&daemon, "ran: verdict pass");
    let (status, told) = due(1);
    assert!(
        status == 409 && told["message"].as_str().unwrap().contains("started already"),
        "{told}"
    );
    let (status, told) = ask(&daemon, "POST", "/disarm", &json!({"who": "Eve"}));
    assert!(status == 202 && told["armed"][0]["ended"].is_array(), "{told}");
    bench.wall.set("2026-11-23T13:00:00Z");
    assert_eq!(due(1).0, 409);
    assert_eq!(bench.shop.states(), ["finished"]);
    let audits = bench.shop.json(&["schedule", bench::NAME, "--json"]);
    assert_eq!(audits[0]["armed"][0]["who"], "Ada");
}

fn main() {
    waiting::run(named![
        daylight_saving_both_ways,
        a_clock_set_back_in_mid_run,
        a_manual_run_is_on,
        a_manual_run_is_on_and_nobody_waits,
        a_machine_that_is_not_ready,
        the_power_goes_over_its_time_and_in_its_run,
        a_call_that_a_cycle_is_due_is_judged_like_the_schedule,
    ]);
}
