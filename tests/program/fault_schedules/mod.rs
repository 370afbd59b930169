//! Seeded fault schedules: runs of a short self-calibration over a bad wire, on a faulty control. The invariants
//! hold in every run. One schedule alone, with its tape: `TRUED_FAULT_SEED=17 cargo test --test program
//! fault_schedules`.

mod bench;
mod invariants;
mod tape;

use crate::support::harness::{Pool, Trials, trials};
use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use testing::population::population_size;

use bench::{EndedRun, FAULT_KINDS, FaultSchedule, ScheduleBench};
use simulator::controls::grbl::FaultKind;

const FULL_SCHEDULES: u64 = 500;

/// Number of occurrences.
#[derive(Default)]
struct ScheduleCounts {
    endings: BTreeMap<String, u32>,
    wire_faults: BTreeMap<String, u32>,
    faults: BTreeMap<FaultKind, u32>,
    violations: Vec<String>,
}

/// The first word of a value's `Debug` output.
fn variant_name(value: impl std::fmt::Debug) -> String {
    let text = format!("{value:?}");
    text.split(|c: char| !c.is_alphanumeric()).next().unwrap_or_default().to_owned()
}

fn ending_name(ended: &EndedRun) -> String {
    match &ended.result {
        Ok(()) => "Finished".to_owned(),
        Err(error) => match error.controller_error() {
            Some(control) => variant_name(control),
            None => variant_name(error),
        },
    }
}

impl ScheduleCounts {
    fn add_run(&mut self, seed: u64, ended: &EndedRun) {
        *self.endings.entry(ending_name(ended)).or_default() += 1;
        for planned in &ended.planned_faults {
            *self.wire_faults.entry(variant_name(planned.fault)).or_default() += 1;
        }
        for kind in &ended.occurred_faults {
            *self.faults.entry(*kind).or_default() += 1;
        }
        let breaches = invariants::violations(ended).into_iter();
        self.violations.extend(breaches.map(|breach| format!("seed {seed}: {breach}")));
    }
}

fn run_schedule(seed: u64) {
    let schedule = FaultSchedule::from_seed(seed);
    let ended = ScheduleBench::new().run(&schedule);
    for (tape, entries) in [("near", &ended.driver_side), ("far", &ended.control_side)] {
        entries.iter().for_each(|entry| println!("{tape} {:?} {:?}", entry.direction, entry.line));
    }
    println!("{schedule:?}\n{:?}\n{:?}", ended.planned_faults, ended.occurred_faults);
    println!("{:?}", ended.result);
    let breaches = invariants::violations(&ended);
    assert!(breaches.is_empty(), "{breaches:#?}");
}

fn whatever_fails_nothing_moves_after_it_and_no_reading_is_lost_doubled_or_invented() {
    if let Ok(seed) = std::env::var("TRUED_FAULT_SEED") {
        return run_schedule(seed.parse().unwrap());
    }
    let schedules = population_size(FULL_SCHEDULES);
    let (next, count) = (AtomicU64::new(0), Mutex::new(ScheduleCounts::default()));
    // Most of the time a run waits for an answer that does not come.
    let threads = 2 * std::thread::available_parallelism().map_or(2, |threads| threads.get());
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                let bench = ScheduleBench::new();
                loop {
                    let seed = next.fetch_add(1, Ordering::SeqCst);
                    if seed >= schedules {
                        return;
                    }
                    let ended = bench.run(&FaultSchedule::from_seed(seed));
                    count.lock().unwrap().add_run(seed, &ended);
                }
            });
        }
    });
    let count = count.into_inner().unwrap();
    println!("endings {:?}", count.endings);
    println!("harms on the wire {:?}", count.wire_faults);
    println!("faults of the control {:?}", count.faults);
    assert!(count.violations.is_empty(), "{:#?}", count.violations);
    if schedules == FULL_SCHEDULES {
        assert_all_kinds_occurred(&count);
    } else {
        assert!(count.endings.len() > 1 && !count.wire_faults.is_empty() && !count.faults.is_empty());
    }
}

/// Asserts that each wire fault, each control fault and each result occurred.
fn assert_all_kinds_occurred(count: &ScheduleCounts) {
    assert_eq!(count.wire_faults.len(), 9);
    assert_eq!(count.faults.len(), FAULT_KINDS.len());
    for ending in [
        "Finished",
        "NoAnswer",
        "Alarm",
        "Reset",
        "Refused",
        "HeldAtControl",
        "UnexpectedReply",
        "Link",
        "NoContact",
        "UnexpectedContact",
        "ProbeStillClosed",
        "NotReady",
        "Halted",
        "UnreadableReply",
    ] {
        assert!(count.endings.contains_key(ending), "no run ended as {ending}");
    }
}

pub fn trials() -> Trials {
    trials![Pool::Computing, 10;
        invariants::window_violation_and_report_fault_are_detected,
        whatever_fails_nothing_moves_after_it_and_no_reading_is_lost_doubled_or_invented,
    ]
}
