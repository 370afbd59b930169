//! Disks that are full, fail, write partially or are slow: `tests/peers/faulty_disk/shim.c` intercepts the calls
//! between the program and its journal.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use super::disk_image::{DiskEvent, parse_events};
use super::{DurabilityBench, assert_journal_is_valid, assert_readings_kept, stderr_text};
use crate::support::recording_control::WireRecord;

/// The shim, compiled into `folder`.
pub fn build_fault_library(folder: &Path) -> PathBuf {
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/faulty_disk/shim.c");
    let library = folder.join("faulty_disk.so");
    let compiled = Command::new("cc")
        .args(["-Wall", "-Werror", "-shared", "-fPIC", "-O1", "-o"])
        .arg(&library)
        .args([source, "-ldl"])
        .output()
        .unwrap();
    assert!(compiled.status.success(), "{}", stderr_text(&compiled));
    library
}

/// A whole run on a disk with these `faults`.
fn run_with_faults(bench: &DurabilityBench, faults: &[(&str, String)]) -> (Output, WireRecord) {
    let (shim, disk) = (build_fault_library(bench.folder.path()), bench.disk_folder());
    bench.run_to_end(|command| {
        command.env("LD_PRELOAD", shim).env("FAULTY_DISK", disk);
        command.envs(faults.iter().map(|(name, value)| (name, value)));
    })
}

/// Bytes written, writes and syncs of a whole run, as the shim logs them, and its number of touches.
struct DiskUse {
    written_bytes: u64,
    write_count: u64,
    sync_count: u64,
    /// Numbers of the syncs directly after a write to the same file: commits. SQLite ignores an error of the other
    /// syncs, of a folder or before a checkpoint, as these are done again.
    commit_sync_numbers: Vec<u64>,
    touch_count: usize,
}

/// Disk use of a run without a fault, and its standard output.
fn disk_use_and_stdout() -> (DiskUse, Vec<u8>) {
    let bench = DurabilityBench::new();
    let log = bench.path_in_folder("disk.log");
    let (output, record) = run_with_faults(&bench, &[("FAULTY_LOG", log.display().to_string())]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr_text(&output));
    assert_readings_kept(&bench.exported_readings(1), &record);
    let mut effort = DiskUse {
        written_bytes: 0,
        write_count: 0,
        sync_count: 0,
        commit_sync_numbers: Vec::new(),
        touch_count: record.reported_touch_positions().len(),
    };
    let mut last_written_file = None;
    for event in parse_events(&log) {
        match event {
            DiskEvent::Write { id, data, .. } => {
                effort.written_bytes += data.len() as u64;
                effort.write_count += 1;
                last_written_file = Some(id);
            }
            DiskEvent::SyncFile { id } => {
                if last_written_file.take() == Some(id) {
                    effort.commit_sync_numbers.push(effort.sync_count);
                }
                effort.sync_count += 1;
            }
            DiskEvent::SyncFolder { .. } => effort.sync_count += 1,
            _ => {}
        }
    }
    (effort, output.stdout)
}

/// Checks a run with the fault from operation `at` on: it ends with an error and one of `words`, every acknowledged
/// reading is stored, and the next start finds the run held, interrupted, failed or complete.
fn check_run_stops_cleanly_at_disk_fault(whole: &DiskUse, fault: &str, at: u64, words: &[&str]) {
    let bench = DurabilityBench::new();
    let (output, record) = run_with_faults(&bench, &[(fault, at.to_string())]);
    let (moved, told) = (!record.reported_touch_positions().is_empty(), stderr_text(&output));
    println!("{fault}={at}: {:?}, {} touches, {told}", output.status.code(), record.reported_touch_positions().len());
    let code = output.status.code();
    // Everything was measured, but the result cannot be stored: nothing was stopped.
    let unkept = record.reported_touch_positions().len() == whole.touch_count && code == Some(1);
    assert!(unkept || code == Some(if moved { 5 } else { 1 }), "{fault}={at}: {code:?} {told}");
    assert!(output.stdout.is_empty(), "{fault}={at}: an estimate in spite of everything");
    assert!(words.iter().any(|word| told.contains(word)), "{fault}={at}: {told}");
    assert!(told.contains("\n  → "), "{fault}={at}: {told}");
    assert!(moved || record.last_started_step() == 0);
    if !bench.state_folder().join("journal.sqlite").exists() {
        return;
    }
    assert_journal_is_valid(&bench.state_folder());
    bench.mark_interrupted_runs_by_next_command();
    match bench.run_states().as_slice() {
        [] => assert!(!moved, "moved without a run in the journal"),
        [state] => {
            // Everything was measured, but the final state could not be written.
            let complete = ["not identified", "finished"].contains(&state.as_str());
            let complete = complete && bench.exported_readings(1).len() == whole.touch_count;
            let states = if moved { ["held", "interrupted"] } else { ["failed", "interrupted"] };
            assert!(complete || states.contains(&state.as_str()), "{fault}={at}: {state}");
            assert_readings_kept(&bench.exported_readings(1), &record);
        }
        more => panic!("{more:?}"),
    }
}

pub fn full_or_failing_disk_stops_the_run_cleanly() {
    check_disk_faults(4);
}

pub fn full_or_failing_disk_stops_the_run_cleanly_at_32_moments() {
    check_disk_faults(8);
}

/// Each of four faults at `moments_per_fault` moments of a run.
fn check_disk_faults(moments_per_fault: u64) {
    let (whole, _) = disk_use_and_stdout();
    let full = ["the disk is full", "No space left on device", "the disk reports an error"];
    let failing = ["the disk reports an error", "Input/output error"];
    let moments_of = |all: u64| (0..moments_per_fault).map(|part| all * part / moments_per_fault).collect::<Vec<u64>>();
    let commits = &whole.commit_sync_numbers;
    let of_commits = moments_of(commits.len() as u64).into_iter().map(|index| commits[index as usize]).collect();
    let faults: [(&str, Vec<u64>, &[&str]); 4] = [
        ("FAULTY_FULL_AFTER", moments_of(whole.written_bytes), &full),
        ("FAULTY_WRITE_AFTER", moments_of(whole.write_count), &failing),
        ("FAULTY_SYNC_AFTER", moments_of(whole.sync_count), &failing),
        ("FAULTY_SYNC_ONCE", of_commits, &failing),
    ];
    let whole = &whole;
    std::thread::scope(|scope| {
        for (fault, numbers, words) in faults {
            scope.spawn(move || {
                numbers.iter().for_each(|at| check_run_stops_cleanly_at_disk_fault(whole, fault, *at, words));
            });
        }
    });
}

/// Number of bytes written in the middle of the transaction that stores the estimate of a whole run. The middle,
/// because another run may write a page more or less before it.
fn written_bytes_at_middle_of_estimate() -> u64 {
    let bench = DurabilityBench::new();
    let log = bench.path_in_folder("disk.log");
    let (output, _) = run_with_faults(&bench, &[("FAULTY_LOG", log.display().to_string())]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr_text(&output));
    let (mut bytes, mut synced, mut is_it) = (0, 0, false);
    for event in parse_events(&log) {
        match event {
            DiskEvent::Write { data, .. } => {
                is_it |= data.windows(ESTIMATE_HEAD.len()).any(|some| some == ESTIMATE_HEAD);
                bytes += data.len() as u64;
            }
            DiskEvent::SyncFile { .. } if is_it => return (synced + bytes) / 2,
            DiskEvent::SyncFile { .. } => synced = bytes,
            _ => {}
        }
    }
    panic!("no estimate was written");
}

/// First bytes of each estimate.
const ESTIMATE_HEAD: &[u8] = b"{\"trued_estimate\":";

/// All readings are stored, but the estimate is not: this is reported, nothing is stopped, and the estimate can be
/// computed again once there is space.
pub fn disk_full_after_the_last_touch_loses_only_the_estimate() {
    let (whole, found) = disk_use_and_stdout();
    let full = written_bytes_at_middle_of_estimate();
    assert!(full < whole.written_bytes);
    let bench = DurabilityBench::new();
    let (output, record) = run_with_faults(&bench, &[("FAULTY_FULL_AFTER", full.to_string())]);
    let told = stderr_text(&output);
    assert_eq!((output.status.code(), record.reported_touch_positions().len()), (Some(1), whole.touch_count), "{told}");
    assert!(output.stdout.is_empty() && told.contains("the estimate could not be stored"), "{told}");
    for words in ["free space on the disk of the journal", "identify self-calibration --run 1`"] {
        assert!(told.contains(words), "{words} in {told}");
    }
    assert_journal_is_valid(&bench.state_folder());
    assert_eq!(bench.run_states(), ["not identified"]);
    assert_eq!(bench.exported_readings(1).len(), whole.touch_count);
    assert_readings_kept(&bench.exported_readings(1), &record);
    let again = ["identify", "self-calibration", "--run", "1", "--json"];
    let again = bench.trued_command(&again).output().unwrap();
    assert!(again.status.success() && again.stdout == found, "{}", stderr_text(&again));
}

pub fn partial_and_slow_writes_change_nothing() {
    let (whole, estimate) = disk_use_and_stdout();
    for (fault, value) in [("FAULTY_SHORT", "1"), ("FAULTY_SLOW_MS", "100")] {
        let bench = DurabilityBench::new();
        let (output, record) = run_with_faults(&bench, &[(fault, value.to_owned())]);
        assert_eq!(output.status.code(), Some(0), "{fault}: {}", stderr_text(&output));
        assert!(output.stdout == estimate, "{fault} changed the estimate");
        assert_journal_is_valid(&bench.state_folder());
        assert_eq!(bench.run_states(), ["finished"]);
        assert_readings_kept(&bench.exported_readings(1), &record);
        assert_eq!(record.reported_touch_positions().len(), whole.touch_count);
    }
}
