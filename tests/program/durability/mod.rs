//! Acknowledged readings are durable: the real program, killed at random moments, on disks that are full or fail,
//! and after a power cut. The independent witness is the simulated control in this process: a request for a touch
//! proves that the previous one is durable.

use crate::support::harness::{Pool, Trials, trials};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use machine::record::reading::Reading;
use trued::report::readings_csv;

mod disk_faults;
mod disk_image;
mod power_cuts;
mod random_kills;

use crate::support::journal_checksums;
use crate::support::recording_control::{self as witness, RecordingControl, WireRecord};

/// A folder with a journal and a machine file.
struct DurabilityBench {
    folder: tempfile::TempDir,
}

impl DurabilityBench {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    fn path_in_folder(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The disk of the journal.
    fn disk_folder(&self) -> PathBuf {
        let disk = self.path_in_folder("disk");
        std::fs::create_dir_all(&disk).unwrap();
        disk
    }

    fn state_folder(&self) -> PathBuf {
        self.disk_folder().join("state")
    }

    fn trued_command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
        command.args(arguments).arg("--state").arg(self.state_folder());
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// The command `trued run` with the control at `address`.
    fn trued_run_command(&self, address: &str) -> Command {
        let machine = self.path_in_folder("machine.toml");
        std::fs::write(&machine, witness::machine_with_control(address)).unwrap();
        self.trued_command(&["run", "self-calibration", "--json", "--machine", machine.to_str().unwrap()])
    }

    /// Runs to the end, successful or not; returns the output and what the recording control received.
    fn run_to_end(&self, prepare: impl FnOnce(&mut Command)) -> (Output, WireRecord) {
        let witness = RecordingControl::start();
        let mut command = self.trued_run_command(&witness.address());
        prepare(&mut command);
        let output = command.output().unwrap();
        (output, witness.stop_and_take_record())
    }

    /// Runs a command that takes the machine's lock, so that an interrupted run is marked. The command fails: there is
    /// no control at its address.
    fn mark_interrupted_runs_by_next_command(&self) {
        let refused = self.trued_run_command("127.0.0.1:1").output().unwrap();
        assert_eq!(refused.status.code(), Some(1), "{}", stderr_text(&refused));
    }

    /// States of all runs, oldest first.
    fn run_states(&self) -> Vec<String> {
        let listed = self.trued_command(&["runs", "--json"]).output().unwrap();
        assert_eq!(listed.status.code(), Some(0), "{}", stderr_text(&listed));
        let runs: serde_json::Value = serde_json::from_slice(&listed.stdout).unwrap();
        let state = |run: &serde_json::Value| run["state"].as_str().unwrap().to_owned();
        runs.as_array().unwrap().iter().map(state).collect()
    }

    fn exported_readings(&self, run: usize) -> Vec<Reading> {
        let to = self.path_in_folder("export");
        let arguments = ["export", &run.to_string(), "--to", to.to_str().unwrap()];
        let exported = self.trued_command(&arguments).output().unwrap();
        assert_eq!(exported.status.code(), Some(0), "{}", stderr_text(&exported));
        let csv = std::fs::read(to.join(format!("run-{run}-readings.csv"))).unwrap();
        readings_csv::read_readings(&csv).unwrap()
    }
}

fn stderr_text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Checks a copy of the journal with SQLite's integrity check and the checksums of its rows.
fn assert_journal_is_valid(state: &Path) {
    let copy = tempfile::tempdir().unwrap();
    for end in ["", "-wal", "-journal"] {
        let name = format!("journal.sqlite{end}");
        if state.join(&name).exists() {
            std::fs::copy(state.join(&name), copy.path().join(&name)).unwrap();
        }
    }
    let database = rusqlite::Connection::open(copy.path().join("journal.sqlite")).unwrap();
    let verdict: String = database.query_row("PRAGMA integrity_check", [], |row| row.get(0)).unwrap();
    assert_eq!(verdict, "ok");
    journal_checksums::assert_checksums(&database);
}

/// Asserts that no reading is lost or invented: each reading is a touch that the control made, and at most the
/// current touch is not stored.
fn assert_readings_kept(readings: &[Reading], record: &WireRecord) {
    let touches = record.reported_touch_positions();
    let (kept, made) = (readings.len(), touches.len());
    assert!(kept <= made, "{kept} kept of {made} touches");
    assert!(kept >= record.last_started_step(), "{kept} kept, but step {} was begun", record.last_started_step());
    assert!(kept + 1 >= made, "{kept} kept of {made} touches");
    for ((reading, touch), step) in readings.iter().zip(touches).zip(0..) {
        assert_eq!(reading.step, step);
        let at: Vec<f64> = reading.position.iter().map(|(axis, value)| axis.to_mm_or_deg(value)).collect();
        assert_eq!(at[..touch.len()], touch, "step {step}");
    }
}

pub fn trials() -> Trials {
    trials![Pool::Computing, 90;
        disk_faults::full_or_failing_disk_stops_the_run_cleanly,
    ]
    .with_trials(trials![Pool::Waiting, 60;
        random_kills::ten_kills_lose_no_acknowledged_reading,
    ])
    .with_trials(trials![Pool::Waiting, 20;
        disk_faults::partial_and_slow_writes_change_nothing,
        power_cuts::eighty_power_cuts_lose_no_acknowledged_reading,
    ])
    .with_trials(trials![Pool::Waiting, 0;
        disk_faults::disk_full_after_the_last_touch_loses_only_the_estimate,
    ])
    .with_trials(
        trials![Pool::Waiting, 0;
            random_kills::two_hundred_kills_lose_no_acknowledged_reading,
            disk_faults::full_or_failing_disk_stops_the_run_cleanly_at_32_moments,
            power_cuts::thousand_power_cuts_lose_no_acknowledged_reading,
        ]
        .mark_ignored(),
    )
}
