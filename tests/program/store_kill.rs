//! The journal and the machine lock when a process is killed during a run (SIGKILL). The child is this test binary
//! again. A kill shows what the process loses, not what a power cut would: for that the journal relies on SQLite's
//! synced commits.

use crate::support::harness::{Pool, Trials, trials};
use std::io::{BufRead, BufReader, Lines};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};

use machine::record::plan::Plan;
use machine::record::reading::{Reading, ReadingFlag};
use machine::{Axis, Position};
use trued::store::{Journal, LockError, MachineLock, NewRun, RunState};

const STATE_FOLDER_VARIABLE: &str = "TRUED_TEST_STATE";
const KILL_COUNT: usize = 3;
/// Minimum number of acknowledged readings before each kill.
const READINGS_BEFORE_KILL: [usize; KILL_COUNT] = [1, 20, 57];

fn reading_of_step(step: u32) -> Reading {
    Reading {
        step,
        repeat: 0,
        position: Position::new().with(Axis::X, f64::from(step).sqrt()),
        value_mm: None,
        sensor: "probe".to_owned(),
        t_s: f64::from(step),
        flag: ReadingFlag::None,
        temperatures_c: Default::default(),
    }
}

fn plan_without_steps() -> Plan {
    serde_json::from_value(serde_json::json!({
        "trued_plan": 1, "method": "none", "settings": {},
        "machine": {"name": "mill", "topology": "w-C-B-X-F-Z-Y-S-t"},
        "probe": {"ball_radius_mm": 3.0},
        "artefact": {"kind": "cylinder", "centre_mm": [0, 0, 0], "axis": [0, 0, 1],
                     "radius_mm": 45.0},
    }))
    .unwrap()
}

/// Whether this process is the child that the trial starts and kills.
pub fn is_writer_child() -> bool {
    std::env::var_os(STATE_FOLDER_VARIABLE).is_some()
}

pub fn write_readings_until_killed() {
    let state = std::env::var_os(STATE_FOLDER_VARIABLE).expect("a state folder");
    let state = Path::new(&state);
    let lock = MachineLock::acquire(state, "mill").unwrap();
    let journal = Journal::open(state).unwrap();
    journal.mark_running_runs_interrupted(&lock).wait().unwrap();
    let run =
        journal.begin_run(&NewRun { machine_file_text: String::new(), plan: plan_without_steps() }).wait().unwrap();
    for step in 0.. {
        journal.add_reading(run, &reading_of_step(step)).wait().unwrap();
        println!("acknowledged {step}");
    }
}

fn start_writer_child(state: &Path) -> (Child, Lines<BufReader<ChildStdout>>) {
    let mut child = Command::new(std::env::current_exe().unwrap())
        .env(STATE_FOLDER_VARIABLE, state)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap()).lines();
    (child, lines)
}

fn acknowledged_step(line: &str) -> Option<u32> {
    line.strip_prefix("acknowledged ")?.parse().ok()
}

fn killed_writer_loses_no_acknowledged_reading() {
    let dir = tempfile::tempdir().unwrap();
    let mut last = Vec::new();
    for reading_count in READINGS_BEFORE_KILL {
        let (mut child, lines) = start_writer_child(dir.path());
        let mut lines = lines.map_while(Result::ok);
        let before = lines.by_ref().filter_map(|line| acknowledged_step(&line)).nth(reading_count - 1);
        assert!(before.is_some(), "the child ended by itself");
        let refused = MachineLock::acquire(dir.path(), "mill").unwrap_err();
        let LockError::MachineInUse { holder: Some(holder), .. } = refused else { panic!("{refused}") };
        assert_eq!(holder.pid, child.id());
        child.kill().unwrap();
        child.wait().unwrap();
        // The pipe may still contain output from before the kill.
        last.push(lines.filter_map(|line| acknowledged_step(&line)).last().or(before).unwrap());
    }

    let lock = MachineLock::acquire(dir.path(), "mill").unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let dead = journal.mark_running_runs_interrupted(&lock).wait().unwrap();
    let runs = journal.runs().unwrap();
    assert_eq!((dead.len(), runs.len()), (1, KILL_COUNT), "each start marks the run before it");
    for (run, last) in runs.iter().zip(last) {
        assert_eq!(run.state, RunState::Interrupted);
        let stored = journal.load_run(run.id).unwrap().readings;
        assert!(stored.len() > last as usize, "{} stored, {last} acknowledged", stored.len());
        assert!(stored.iter().zip(0..).all(|(stored, step)| *stored == reading_of_step(step)));
    }
    drop(journal);
    let database = rusqlite::Connection::open(dir.path().join("journal.sqlite")).unwrap();
    let verdict: String = database.query_row("PRAGMA integrity_check", [], |row| row.get(0)).unwrap();
    assert_eq!(verdict, "ok");
}

pub fn trials() -> Trials {
    trials![Pool::Waiting, 0;
        killed_writer_loses_no_acknowledged_reading,
    ]
}
