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
use testing::population::population;

use bench::{Bench, Ended, Schedule};
use simulator::controls::grbl::FaultKind;

const FULL_SCHEDULES: u64 = 500;

/// Number of occurrences.
#[derive(Default)]
struct Count {
    endings: BTreeMap<String, u32>,
    harms: BTreeMap<String, u32>,
    faults: BTreeMap<FaultKind, u32>,
    breaches: Vec<String>,
}

/// The first word of a value's `Debug` output.
fn name(value: impl std::fmt::Debug) -> String {
    let text = format!("{value:?}");
    text.split(|c: char| !c.is_alphanumeric()).next().unwrap_or_default().to_owned()
}

fn ending(ended: &Ended) -> String {
    match &ended.result {
        Ok(()) => "Finished".to_owned(),
        Err(error) => match error.controller_error() {
            Some(control) => name(control),
            None => name(error),
        },
    }
}

impl Count {
    fn add(&mut self, seed: u64, ended: &Ended) {
        *self.endings.entry(ending(ended)).or_default() += 1;
        for planned in &ended.harms {
            *self.harms.entry(name(planned.fault)).or_default() += 1;
        }
        for kind in &ended.happened {
            *self.faults.entry(*kind).or_default() += 1;
        }
        let breaches = invariants::breaches(ended).into_iter();
        self.breaches.extend(breaches.map(|breach| format!("seed {seed}: {breach}")));
    }
}

fn one(seed: u64) {
    let schedule = Schedule::of(seed);
    let ended = Bench::new().run(&schedule);
    for (tape, entries) in [("near", &ended.near), ("far", &ended.far)] {
        entries.iter().for_each(|entry| println!("{tape} {:?} {:?}", entry.way, entry.line));
    }
    println!("{schedule:?}\n{:?}\n{:?}", ended.harms, ended.happened);
    println!("{:?}", ended.result);
    let breaches = invariants::breaches(&ended);
    assert!(breaches.is_empty(), "{breaches:#?}");
}

fn whatever_fails_nothing_moves_after_it_and_no_reading_is_lost_doubled_or_invented() {
    if let Ok(seed) = std::env::var("TRUED_FAULT_SEED") {
        return one(seed.parse().unwrap());
    }
    let schedules = population(FULL_SCHEDULES);
    let (next, count) = (AtomicU64::new(0), Mutex::new(Count::default()));
    // Most of the time a run waits for an answer that does not come.
    let threads = 2 * std::thread::available_parallelism().map_or(2, |threads| threads.get());
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                let bench = Bench::new();
                loop {
                    let seed = next.fetch_add(1, Ordering::SeqCst);
                    if seed >= schedules {
                        return;
                    }
                    let ended = bench.run(&Schedule::of(seed));
                    count.lock().unwrap().add(seed, &ended);
                }
            });
        }
    });
    let count = count.into_inner().unwrap();
    println!("endings {:?}", count.endings);
    println!("harms on the wire {:?}", count.harms);
    println!("faults of the control {:?}", count.faults);
    assert!(count.breaches.is_empty(), "{:#?}", count.breaches);
    if schedules == FULL_SCHEDULES {
        assert_mix(&count);
    } else {
        assert!(count.endings.len() > 1 && !count.harms.is_empty() && !count.faults.is_empty());
    }
}

/// Asserts that each wire fault, each control fault and each result occurred.
fn assert_mix(count: &Count) {
    assert_eq!(count.harms.len(), 9);
    assert_eq!(count.faults.len(), FaultKind::ALL.len());
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
        invariants::a_breach_of_the_window_and_a_fault_in_a_report_are_seen,
        whatever_fails_nothing_moves_after_it_and_no_reading_is_lost_doubled_or_invented,
    ]
}
