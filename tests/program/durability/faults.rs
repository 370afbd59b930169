//! Disks that are full, fail, write partially or are slow: `tests/peers/faulty_disk/shim.c` intercepts the calls
//! between the program and its journal.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use super::{Bench, assert_kept, assert_whole, said};
use crate::support::recording_control::Record;

/// The shim, compiled into `folder`.
pub fn shim(folder: &Path) -> PathBuf {
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/faulty_disk/shim.c");
    let library = folder.join("faulty_disk.so");
    let compiled = Command::new("cc")
        .args(["-Wall", "-Werror", "-shared", "-fPIC", "-O1", "-o"])
        .arg(&library)
        .args([source, "-ldl"])
        .output()
        .unwrap();
    assert!(compiled.status.success(), "{}", said(&compiled));
    library
}

/// A whole run on a disk with these `faults`.
fn run(bench: &Bench, faults: &[(&str, String)]) -> (Output, Record) {
    let (shim, disk) = (shim(bench.folder.path()), bench.disk());
    bench.run_whole(|command| {
        command.env("LD_PRELOAD", shim).env("FAULTY_DISK", disk);
        command.envs(faults.iter().map(|(name, value)| (name, value)));
    })
}

/// Bytes written, writes and syncs of a whole run, as the shim logs them.
struct Effort {
    bytes: u64,
    writes: u64,
    syncs: u64,
    touches: usize,
}

fn effort() -> (Effort, Vec<u8>) {
    let bench = Bench::new();
    let log = bench.path("disk.log");
    let (output, record) = run(&bench, &[("FAULTY_LOG", log.display().to_string())]);
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    assert_kept(&bench.readings(1), &record);
    let mut effort = Effort { bytes: 0, writes: 0, syncs: 0, touches: record.touches().len() };
    for event in super::image::events(&log) {
        match event {
            super::image::Event::Write { data, .. } => {
                effort.bytes += data.len() as u64;
                effort.writes += 1;
            }
            super::image::Event::Sync { .. } | super::image::Event::SyncFolder { .. } => {
                effort.syncs += 1;
            }
            _ => {}
        }
    }
    (effort, output.stdout)
}

/// The run ends with `code` and `words`; every acknowledged reading is stored, nothing moves afterwards, and the
/// next start finds the run held or interrupted.
fn stops_cleanly(whole: &Effort, fault: &str, at: u64, words: &[&str]) {
    let bench = Bench::new();
    let (output, record) = run(&bench, &[(fault, at.to_string())]);
    let (moved, told) = (!record.touches().is_empty(), said(&output));
    println!("{fault}={at}: {:?}, {} touches, {told}", output.status.code(), record.touches().len());
    let code = output.status.code();
    // Everything was measured, but the result cannot be stored: nothing was stopped.
    let unkept = record.touches().len() == whole.touches && code == Some(1);
    assert!(unkept || code == Some(if moved { 5 } else { 1 }), "{fault}={at}: {code:?} {told}");
    assert!(output.stdout.is_empty(), "{fault}={at}: an estimate in spite of everything");
    assert!(words.iter().any(|word| told.contains(word)), "{fault}={at}: {told}");
    assert!(told.contains("\n  → "), "{fault}={at}: {told}");
    assert!(moved || record.begun() == 0);
    if !bench.state().join("journal.sqlite").exists() {
        return;
    }
    assert_whole(&bench.state());
    bench.next_start();
    match bench.states().as_slice() {
        [] => assert!(!moved, "moved without a run in the journal"),
        [state] => {
            // Everything was measured, but the final state could not be written.
            let complete = ["not identified", "finished"].contains(&state.as_str());
            let complete = complete && bench.readings(1).len() == whole.touches;
            let states = if moved { ["held", "interrupted"] } else { ["failed", "interrupted"] };
            assert!(complete || states.contains(&state.as_str()), "{fault}={at}: {state}");
            assert_kept(&bench.readings(1), &record);
        }
        more => panic!("{more:?}"),
    }
}

pub fn a_full_or_failing_disk_stops_the_run_cleanly() {
    let (whole, _) = effort();
    let full = ["the disk is full", "No space left on device", "the disk reports an error"];
    let failing = ["the disk reports an error", "Input/output error"];
    let faults: [(&str, u64, &[&str]); 4] = [
        ("FAULTY_FULL_AFTER", whole.bytes, &full),
        ("FAULTY_WRITE_AFTER", whole.writes, &failing),
        ("FAULTY_SYNC_AFTER", whole.syncs, &failing),
        ("FAULTY_SYNC_ONCE", whole.syncs, &failing),
    ];
    let whole = &whole;
    std::thread::scope(|scope| {
        for (fault, all, words) in faults {
            scope.spawn(move || {
                (0..8).for_each(|eighth| stops_cleanly(whole, fault, all * eighth / 8, words));
            });
        }
    });
}

/// Number of bytes written in the middle of the transaction that stores the estimate of a whole run. The middle,
/// because another run may write a page more or less before it.
fn amid_the_estimate() -> u64 {
    let bench = Bench::new();
    let log = bench.path("disk.log");
    let (output, _) = run(&bench, &[("FAULTY_LOG", log.display().to_string())]);
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    let (mut bytes, mut synced, mut is_it) = (0, 0, false);
    for event in super::image::events(&log) {
        match event {
            super::image::Event::Write { data, .. } => {
                is_it |= data.windows(ESTIMATE.len()).any(|some| some == ESTIMATE);
                bytes += data.len() as u64;
            }
            super::image::Event::Sync { .. } if is_it => return (synced + bytes) / 2,
            super::image::Event::Sync { .. } => synced = bytes,
            _ => {}
        }
    }
    panic!("no estimate was written");
}

/// First bytes of each estimate.
const ESTIMATE: &[u8] = b"{\"trued_estimate\":";

/// All readings are stored, but the estimate is not: this is reported, nothing is stopped, and the estimate can be
/// computed again once there is space.
pub fn a_disk_that_is_full_after_the_last_touch_costs_the_estimate_alone() {
    let (whole, found) = effort();
    let full = amid_the_estimate();
    assert!(full < whole.bytes);
    let bench = Bench::new();
    let (output, record) = run(&bench, &[("FAULTY_FULL_AFTER", full.to_string())]);
    let told = said(&output);
    assert_eq!((output.status.code(), record.touches().len()), (Some(1), whole.touches), "{told}");
    assert!(output.stdout.is_empty() && told.contains("the estimate could not be stored"), "{told}");
    for words in ["free space on the disk of the journal", "identify self-calibration --run 1`"] {
        assert!(told.contains(words), "{words} in {told}");
    }
    assert_whole(&bench.state());
    assert_eq!(bench.states(), ["not identified"]);
    assert_eq!(bench.readings(1).len(), whole.touches);
    assert_kept(&bench.readings(1), &record);
    let again = ["identify", "self-calibration", "--run", "1", "--json"];
    let again = bench.command(&again).output().unwrap();
    assert!(again.status.success() && again.stdout == found, "{}", said(&again));
}

pub fn a_disk_that_writes_in_pieces_or_slowly_changes_nothing() {
    let (whole, estimate) = effort();
    for (fault, value) in [("FAULTY_SHORT", "1"), ("FAULTY_SLOW_MS", "100")] {
        let bench = Bench::new();
        let (output, record) = run(&bench, &[(fault, value.to_owned())]);
        assert_eq!(output.status.code(), Some(0), "{fault}: {}", said(&output));
        assert!(output.stdout == estimate, "{fault} changed the estimate");
        assert_whole(&bench.state());
        assert_eq!(bench.states(), ["finished"]);
        assert_kept(&bench.readings(1), &record);
        assert_eq!(record.touches().len(), whole.touches);
    }
}
