//! Power cuts. The shim's log contains the program's writes and syncs and, in between, the bytes it sent to the
//! machine: a line of the next step means that the previous reading is durable.

use std::path::Path;

use estimation::random;
use machine::record::reading::Reading;
use rand::RngExt;
use trued::store::{Journal, RunState};

use super::disk_image::{DiskEvent, DiskImage, parse_events};
use super::{DurabilityBench, assert_journal_is_valid, disk_faults, stderr_text, witness};

pub fn eighty_power_cuts_lose_no_acknowledged_reading() {
    run_power_cuts(80, 1);
}

pub fn thousand_power_cuts_lose_no_acknowledged_reading() {
    run_power_cuts(1000, 2);
}

/// Half of the cuts are in the first run of a journal, which creates it, half in a later run.
fn run_power_cuts(count: usize, seed: u64) {
    let bench = DurabilityBench::new();
    let shim = disk_faults::build_fault_library(bench.folder.path());
    let mut before: Vec<Vec<Reading>> = Vec::new();
    for run in 1..=2 {
        let log = bench.path_in_folder(&format!("disk-{run}.log"));
        let begins = tempfile::tempdir().unwrap();
        let disk = DiskImage::read_folder(&bench.disk_folder(), &bench.disk_folder());
        disk.write_after_power_cut(&mut random::seeded_stream(0, &[]), begins.path());
        let (output, _) = bench.run_to_end(|command| {
            command.env("LD_PRELOAD", &shim).env("FAULTY_DISK", bench.disk_folder());
            command.env("FAULTY_LOG", &log);
        });
        assert_eq!(output.status.code(), Some(0), "{}", stderr_text(&output));
        let taken = RecordedRun {
            events: parse_events(&log),
            logged_root: bench.disk_folder(),
            initial_image_folder: begins.path(),
            all_readings: bench.exported_readings(run),
            readings_of_earlier_runs: &before,
        };
        let mut in_mid_run = 0;
        for cut in 0..count / 2 {
            let mut random = random::seeded_stream(seed, &[run as u64, cut as u64]);
            let at = random.random_range(0..=taken.events.len());
            in_mid_run += usize::from(taken.check_cut_before_event(at, &mut random) > 0);
        }
        println!("run {run}: {} events, {in_mid_run} cuts between touches", taken.events.len());
        assert!(in_mid_run * 4 > count / 2, "{in_mid_run} cuts met the run");
        before.push(taken.all_readings);
    }
}

/// A complete run with its log.
struct RecordedRun<'a> {
    events: Vec<DiskEvent>,
    logged_root: std::path::PathBuf,
    /// The disk before the run.
    initial_image_folder: &'a Path,
    /// Readings of the run.
    all_readings: Vec<Reading>,
    /// Readings of the earlier runs.
    readings_of_earlier_runs: &'a [Vec<Reading>],
}

impl RecordedRun<'_> {
    /// Cuts the power before the event `at` and checks the state; returns the number of steps that had begun.
    fn check_cut_before_event(&self, at: usize, random: &mut impl RngExt) -> usize {
        let mut disk = DiskImage::read_folder(self.initial_image_folder, &self.logged_root);
        let (mut sent, mut printed) = (Vec::new(), false);
        for event in &self.events[..at] {
            disk.apply_event(event);
            match event {
                DiskEvent::SendToSocket { data } => sent.extend(data),
                DiskEvent::PrintToStdout => printed = true,
                _ => {}
            }
        }
        let begun = witness::last_started_n_word(&sent);
        let moved = String::from_utf8_lossy(&sent).contains("N0 ");
        let left = tempfile::tempdir().unwrap();
        disk.write_after_power_cut(random, left.path());
        let state = left.path().join("state");
        if state.join("journal.sqlite").exists() {
            assert_journal_is_valid(&state);
        }
        let journal = Journal::open(&state).unwrap_or_else(|e| panic!("cut at {at}: {e}"));
        let runs = journal.runs().unwrap();
        for (run, readings) in runs.iter().zip(self.readings_of_earlier_runs) {
            assert_eq!(run.state, RunState::Finished, "cut at {at}");
            assert_eq!(&journal.load_run(run.id).unwrap().readings, readings, "cut at {at}");
        }
        assert!(runs.len() >= self.readings_of_earlier_runs.len(), "cut at {at}: earlier runs are lost");
        let Some(run) = runs.get(self.readings_of_earlier_runs.len()) else {
            assert!(!moved, "cut at {at}: the machine has moved, and no run is known");
            return 0;
        };
        let stored = journal.load_run(run.id).unwrap();
        let kept = stored.readings.len();
        assert!(kept >= begun, "cut at {at}: {kept} kept, but step {begun} was begun");
        assert_eq!(stored.readings, self.all_readings[..kept], "cut at {at}");
        assert!(!moved || stored.plan.steps.len() > begun, "cut at {at}: the plan is cut off");
        assert!(!printed || stored.estimates.len() == 1, "cut at {at}: the result is lost");
        begun
    }
}
