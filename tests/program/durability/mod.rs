//! Acknowledged readings are durable: the real program, killed at random moments, on disks that are full or fail,
//! and after a power cut. The independent witness is the simulated control in this process: a request for a touch
//! proves that the previous one is durable.

use crate::support::harness::{Pool, Trials, trials};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use machine::record::reading::Reading;
use trued::report::readings_csv;

mod faults;
mod image;
mod kills;
mod power;

use crate::support::journal_rows;
use crate::support::recording_control::{self as witness, Record, RecordingControl};

/// A folder with a journal and a machine file.
struct DurabilityBench {
    folder: tempfile::TempDir,
}

impl DurabilityBench {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The disk of the journal.
    fn disk(&self) -> PathBuf {
        let disk = self.path("disk");
        std::fs::create_dir_all(&disk).unwrap();
        disk
    }

    fn state(&self) -> PathBuf {
        self.disk().join("state")
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
        command.args(arguments).arg("--state").arg(self.state());
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// A run with the control at `address`.
    fn run_command(&self, address: &str) -> Command {
        let machine = self.path("machine.toml");
        std::fs::write(&machine, witness::machine_with_control(address)).unwrap();
        self.command(&["run", "self-calibration", "--json", "--machine", machine.to_str().unwrap()])
    }

    /// Runs to the end, successful or not.
    fn run_to_end(&self, prepare: impl FnOnce(&mut Command)) -> (Output, Record) {
        let witness = RecordingControl::start();
        let mut command = self.run_command(&witness.address());
        prepare(&mut command);
        let output = command.output().unwrap();
        (output, witness.stop_and_take_record())
    }

    /// The next command that takes the machine's lock. There is no control at its address.
    fn check_next_start(&self) {
        let refused = self.run_command("127.0.0.1:1").output().unwrap();
        assert_eq!(refused.status.code(), Some(1), "{}", stderr_text(&refused));
    }

    /// States of all runs, oldest first.
    fn run_states(&self) -> Vec<String> {
        let listed = self.command(&["runs", "--json"]).output().unwrap();
        assert_eq!(listed.status.code(), Some(0), "{}", stderr_text(&listed));
        let runs: serde_json::Value = serde_json::from_slice(&listed.stdout).unwrap();
        let state = |run: &serde_json::Value| run["state"].as_str().unwrap().to_owned();
        runs.as_array().unwrap().iter().map(state).collect()
    }

    fn readings(&self, run: usize) -> Vec<Reading> {
        let to = self.path("export");
        let arguments = ["export", &run.to_string(), "--to", to.to_str().unwrap()];
        let exported = self.command(&arguments).output().unwrap();
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
    journal_rows::assert_sealed(&database);
}

/// Asserts that no reading is lost or invented: each reading is a touch that the control made, and at most the
/// current touch is not stored.
fn assert_readings_kept(readings: &[Reading], record: &Record) {
    let touches = record.reported_touches();
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
        faults::full_or_failing_disk_stops_the_run_cleanly,
    ]
    .with(trials![Pool::Waiting, 60;
        kills::twenty_kills_lose_nothing_that_was_acknowledged,
    ])
    .with(trials![Pool::Waiting, 20;
        faults::partial_and_slow_writes_change_nothing,
        power::eighty_power_cuts_lose_no_acknowledged_reading,
    ])
    .with(trials![Pool::Waiting, 0;
        faults::a_disk_that_is_full_after_the_last_touch_costs_the_estimate_alone,
    ])
    .with(
        trials![Pool::Waiting, 0;
            kills::two_hundred_kills_lose_nothing_that_was_acknowledged,
            power::thousand_power_cuts_lose_no_acknowledged_reading,
        ]
        .ignored(),
    )
}
