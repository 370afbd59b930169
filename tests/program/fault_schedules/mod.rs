//! Seeded fault schedules: runs of a short self-calibration over a bad wire, on a faulty control. The invariants
//! hold in every run. One schedule alone, with its tape: `TRUED_FAULT_SEED=17 cargo test --test program
//! fault_schedules`.

mod faulty_run;
mod invariants;
mod wire_recording;

use crate::support::harness::{Pool, Trials, trials};
use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use testing::population::population_size;

use faulty_run::{EndedRun, FAULT_KINDS, FaultSchedule, ScheduleBench};
use simulator::controls::grbl::FaultKind;

/// Number of schedules with `TRUED_FULL=1`.
const FULL_SCHEDULE_COUNT: u64 = 500;

/// Numbers of occurrences over all runs.
#[derive(Default)]
struct ScheduleCounts {
    runs_by_ending: BTreeMap<String, u32>,
    wire_fault_counts: BTreeMap<String, u32>,
    control_fault_counts: BTreeMap<FaultKind, u32>,
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
        *self.runs_by_ending.entry(ending_name(ended)).or_default() += 1;
        for planned in &ended.planned_wire_faults {
            *self.wire_fault_counts.entry(variant_name(planned.fault)).or_default() += 1;
        }
        for kind in &ended.occurred_control_faults {
            *self.control_fault_counts.entry(*kind).or_default() += 1;
        }
        let breaches = invariants::invariant_violations(ended).into_iter();
        self.violations.extend(breaches.map(|breach| format!("seed {seed}: {breach}")));
    }
}

fn check_single_schedule(seed: u64) {
    let schedule = FaultSchedule::from_seed(seed);
    let ended = ScheduleBench::new().run(&schedule);
    for (tape, entries) in [("near", &ended.driver_side_tape), ("far", &ended.control_side_tape)] {
        entries.iter().for_each(|entry| println!("{tape} {:?} {:?}", entry.direction, entry.line));
    }
    println!("{schedule:?}\n{:?}\n{:?}", ended.planned_wire_faults, ended.occurred_control_faults);
    println!("{:?}", ended.result);
    let breaches = invariants::invariant_violations(&ended);
    assert!(breaches.is_empty(), "{breaches:#?}");
}

fn after_a_fault_nothing_moves_and_no_reading_is_lost_doubled_or_invented() {
    if let Ok(seed) = std::env::var("TRUED_FAULT_SEED") {
        return check_single_schedule(seed.parse().unwrap());
    }
    let schedules = population_size(FULL_SCHEDULE_COUNT);
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
    println!("endings {:?}", count.runs_by_ending);
    println!("harms on the wire {:?}", count.wire_fault_counts);
    println!("faults of the control {:?}", count.control_fault_counts);
    assert!(count.violations.is_empty(), "{:#?}", count.violations);
    if schedules == FULL_SCHEDULE_COUNT {
        assert_all_faults_and_endings_occurred(&count);
    } else {
        assert!(
            count.runs_by_ending.len() > 1
                && !count.wire_fault_counts.is_empty()
                && !count.control_fault_counts.is_empty()
        );
    }
}

/// Asserts that each wire fault, each control fault and each result occurred.
fn assert_all_faults_and_endings_occurred(count: &ScheduleCounts) {
    assert_eq!(count.wire_fault_counts.len(), 9);
    assert_eq!(count.control_fault_counts.len(), FAULT_KINDS.len());
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
        assert!(count.runs_by_ending.contains_key(ending), "no run ended as {ending}");
    }
}

pub fn trials() -> Trials {
    trials![Pool::Computing, 10;
        invariants::window_violation_and_report_fault_are_detected,
        after_a_fault_nothing_moves_and_no_reading_is_lost_doubled_or_invented,
    ]
}
