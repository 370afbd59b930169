mod backup_and_retention;
mod damage;
mod list_pages;
mod state_dir_files;

use std::collections::BTreeMap;

use rusqlite::Connection;

use super::*;
use machine::record::estimate::Parameter;
use machine::record::plan::{Step, StepKind};
use machine::record::reading::ReadingFlag;
use machine::{Axis, Position};

fn plan_without_steps() -> Plan {
    serde_json::from_value(serde_json::json!({
        "trued_plan": 1,
        "method": "self-calibration",
        "settings": {"n": 8},
        "machine": {"name": "mill", "topology": "w-C-B-X-F-Z-Y-S-t"},
        "probe": {"ball_radius_mm": 3.0},
        "artefact": {"kind": "cylinder", "centre_mm": [0.3, 0.1, 50.0], "axis": [0, 0, 1],
                     "radius_mm": 45.0},
    }))
    .unwrap()
}

fn new_run() -> NewRun {
    NewRun { machine_file_text: "[machine]\nname = \"mill\"\n".to_owned(), plan: plan_without_steps() }
}

fn plan_step(id: u32) -> Step {
    let angle = f64::from(id) * std::f64::consts::TAU / 7.0;
    Step {
        id,
        stage: 0,
        kind: StepKind::Touch,
        label: format!("1a/{id}"),
        from: Position::new().with(Axis::X, 50.1).with(Axis::C, Axis::C.to_mm_or_rad(45.0)),
        to: Position::new().with(Axis::X, 44.0),
        feed_mm_min: 30.0,
        sensors: vec!["probe".to_owned()],
        normal: [angle.cos(), angle.sin(), 0.0],
        scan: None,
        text: None,
        mount: None,
        watch: Vec::new(),
    }
}

/// A reading none of whose numbers has a short decimal form, neither in radians nor in degrees.
fn reading_of_step(step: u32) -> Reading {
    let angle = f64::from(step) * std::f64::consts::TAU / 7.0;
    Reading {
        step,
        repeat: 1,
        position: Position::new()
            .with(Axis::X, 48.0 * angle.cos())
            .with(Axis::Y, 48.0 * angle.sin())
            .with(Axis::C, angle),
        value_mm: (step % 2 == 1).then_some(angle.sqrt()),
        sensor: "probe".to_owned(),
        t_s: angle.exp(),
        flag: ReadingFlag::ALL[step as usize % ReadingFlag::ALL.len()],
        temperatures_c: BTreeMap::from([("table".to_owned(), 20.0 + angle / 3.0)]).into(),
    }
}

fn estimate_with_value(value: f64) -> Estimate {
    let mut estimate: Estimate = serde_json::from_value(serde_json::json!({
        "trued_estimate": 1, "method": "self-calibration", "parameters": [], "functions": [],
        "covariance": {"symbols": ["EX0C"], "rows": [[0.1]]}, "rank": 1, "unknowns": 1,
        "condition": 1.0, "gauge": ["mean of W is zero"], "not_identifiable": [],
        "residual_rms_um": 0.3, "degrees_of_freedom": 5, "chi2_per_dof": 1.1, "verdict": "none",
        "warnings": [], "priors": [],
    }))
    .unwrap();
    estimate.parameters.push(Parameter {
        symbol: "EX0C".to_owned(),
        value,
        unit: machine::record::estimate::Unit::Um,
        u: 1.0 / 3.0,
        expanded: 2.0 / 3.0,
        k: 2.0,
        dof: None,
        identifiable: true,
        u_monte_carlo: None,
        interval_monte_carlo: None,
        budget: Vec::new(),
        judged: None,
    });
    estimate
}

fn plan_stage(id: u32, steps: Vec<u32>) -> Stage {
    Stage { id, name: format!("Test {id}"), repeat: 0, steps, found: None }
}

#[test]
fn all_data_is_read_back_after_reopening() {
    let dir = tempfile::tempdir().unwrap();
    let events =
        [RunEvent::StageStarted { stage: plan_stage(0, vec![0, 1]) }, RunEvent::Held { reason: "Ctrl-C".to_owned() }];
    let stages = [plan_stage(0, vec![0, 1]), plan_stage(1, vec![2, 0])];
    let readings: Vec<_> = (0..9).map(reading_of_step).collect();
    let journal = Journal::open(dir.path()).unwrap();
    let run = journal.begin_run(&new_run()).wait().unwrap();
    journal.add_stage(run, &stages[0], &[plan_step(0), plan_step(1)]).wait().unwrap();
    journal.add_stage(run, &stages[1], &[plan_step(2)]).wait().unwrap();
    for reading in &readings {
        journal.add_reading(run, reading).wait().unwrap();
    }
    for event in &events {
        journal.add_event(run, event).wait().unwrap();
    }
    let hash = journal.add_estimate(run, &estimate_with_value(0.1 + 0.2)).wait().unwrap();
    journal.set_state(run, RunState::Finished).wait().unwrap();
    drop(journal);

    let stored = Journal::open(dir.path()).unwrap().load_run(run).unwrap();
    assert_eq!(stored.machine_file_text, new_run().machine_file_text);
    assert_eq!(stored.plan.steps, [plan_step(0), plan_step(1), plan_step(2)]);
    assert_eq!(Plan { steps: Vec::new(), ..stored.plan.clone() }, plan_without_steps());
    assert_eq!(stored.stages, stages);
    assert_eq!(stored.readings, readings);
    assert_eq!(stored.events.iter().map(|(_, event)| event.clone()).collect::<Vec<_>>(), events);
    assert_eq!(stored.estimates[0].estimate, estimate_with_value(0.1 + 0.2));
    assert_eq!(stored.estimates[0].sha256, hash);
    assert_eq!(hash, sha256_of_json(&estimate_with_value(0.1 + 0.2)).unwrap());
    let head = &stored.summary;
    assert_eq!((head.method.as_str(), head.machine.as_str()), ("self-calibration", "mill"));
    assert_eq!(head.state, RunState::Finished);
    assert!(head.started <= head.ended.unwrap());
    assert_eq!(head.plan_sha256, sha256_of_json(&stored.plan).unwrap());
    assert_eq!(head.program_version, env!("CARGO_PKG_VERSION"));
}

/// NIST FIPS 180-4, example "abc".
#[test]
fn paper_sha256_of_abc() {
    assert_eq!(sha256_text("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

#[test]
fn second_estimate_of_a_run_keeps_the_first() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let run = journal.begin_run(&new_run()).wait().unwrap();
    let first = journal.add_estimate(run, &estimate_with_value(1.0)).wait().unwrap();
    let second = journal.add_estimate(run, &estimate_with_value(2.0)).wait().unwrap();
    let stored = journal.load_run(run).unwrap().estimates;
    let hashes: Vec<_> = stored.iter().map(|row| row.sha256.clone()).collect();
    assert_eq!(hashes, [first, second]);
    assert_eq!(stored[0].estimate, estimate_with_value(1.0));
}

#[tokio::test(flavor = "current_thread")]
async fn acknowledged_reading_is_visible_to_other_connections() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let run = journal.begin_run(&new_run()).await.unwrap();
    let other = Connection::open(dir.path().join("journal.sqlite")).unwrap();
    for id in 0..5 {
        journal.add_reading(run, &reading_of_step(id)).await.unwrap();
        let last: u32 = other.query_row("SELECT max(step) FROM readings", [], |row| row.get(0)).unwrap();
        assert_eq!(last, id);
    }
}

#[test]
fn writer_uses_full_sync_write_ahead_log_and_foreign_keys() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let pragmas = journal.submit_job(|connection| {
        let synchronous: i64 = connection.pragma_query_value(None, "synchronous", |row| row.get(0))?;
        let mode: String = connection.pragma_query_value(None, "journal_mode", |row| row.get(0))?;
        let keys: bool = connection.pragma_query_value(None, "foreign_keys", |row| row.get(0))?;
        Ok((synchronous, mode, keys))
    });
    assert_eq!(pragmas.wait().unwrap(), (2, "wal".to_owned(), true));
}

#[test]
fn full_disk_is_reported_and_loses_no_acknowledged_reading() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let run = journal.begin_run(&new_run()).wait().unwrap();
    limit_page_count(&journal, "SELECT page_count FROM pragma_page_count");
    let mut acknowledged = Vec::new();
    let full = loop {
        let next = reading_of_step(acknowledged.len() as u32);
        match journal.add_reading(run, &next).wait() {
            Ok(()) => acknowledged.push(next),
            Err(error) => break error,
        }
    };
    assert!(matches!(full.fault, StoreFault::DiskFull), "{full}");
    assert!(full.to_string().contains("full") && full.remedy().contains("free space"));
    assert!(!acknowledged.is_empty(), "the limit must bite in mid-run");
    assert_eq!(journal.load_run(run).unwrap().readings, acknowledged);

    limit_page_count(&journal, "SELECT 1000000");
    acknowledged.push(reading_of_step(acknowledged.len() as u32));
    journal.add_reading(run, acknowledged.last().unwrap()).wait().unwrap();
    assert_eq!(journal.load_run(run).unwrap().readings, acknowledged);
}

fn limit_page_count(journal: &Journal, select: &'static str) {
    let limited = journal.submit_job(move |connection| {
        let pages: i64 = connection.query_row(select, [], |row| row.get(0))?;
        connection.pragma_update_and_check(None, "max_page_count", pages, |row| {
            assert_eq!(row.get::<_, i64>(0)?, pages);
            Ok(())
        })?;
        Ok(())
    });
    limited.wait().unwrap();
}

#[test]
fn non_finite_numbers_unknown_runs_and_existing_steps_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let run = journal.begin_run(&new_run()).wait().unwrap();
    let nan = Reading { value_mm: Some(f64::NAN), ..reading_of_step(0) };
    let hot =
        Reading { temperatures_c: BTreeMap::from([("table".to_owned(), f64::INFINITY)]).into(), ..reading_of_step(0) };
    for bad in [nan, hot] {
        let error = journal.add_reading(run, &bad).wait().unwrap_err();
        assert!(matches!(error.fault, StoreFault::NotFinite { .. }), "{error}");
    }
    let error = journal.add_estimate(run, &estimate_with_value(f64::NAN)).wait().unwrap_err();
    assert!(matches!(error.fault, StoreFault::NotFinite { .. }), "{error}");
    let nobody = RunId(77);
    for error in [
        journal.add_reading(nobody, &reading_of_step(0)).wait().unwrap_err(),
        journal.add_stage(nobody, &plan_stage(0, vec![]), &[]).wait().unwrap_err(),
        journal.set_state(nobody, RunState::Held).wait().unwrap_err(),
        journal.load_run(nobody).unwrap_err(),
    ] {
        assert!(matches!(error.fault, StoreFault::RunNotFound(RunId(77))), "{error}");
    }
    // A step of the plan is never overwritten, and the stage that tried leaves no row.
    journal.add_stage(run, &plan_stage(0, vec![0]), &[plan_step(0)]).wait().unwrap();
    journal.add_stage(run, &plan_stage(1, vec![0]), &[plan_step(0)]).wait().unwrap_err();
    let stored = journal.load_run(run).unwrap();
    assert_eq!((stored.stages.len(), stored.readings.len(), stored.estimates.len()), (1, 0, 0));
}

#[test]
fn touches_are_unique_but_scan_samples_are_not() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let run = journal.begin_run(&new_run()).wait().unwrap();
    let touch = reading_of_step(2);
    journal.add_reading(run, &touch).wait().unwrap();
    let error = journal.add_reading(run, &Reading { t_s: 99.0, ..touch.clone() }).wait().unwrap_err();
    assert!(matches!(error.fault, StoreFault::DuplicateTouch { step: 2, repeat: 1 }), "{error}");
    let again = Reading { repeat: 1000, ..touch.clone() };
    journal.add_reading(run, &again).wait().unwrap();
    let other = journal.begin_run(&new_run()).wait().unwrap();
    journal.add_reading(other, &touch).wait().unwrap();
    for _ in 0..2 {
        journal.add_reading(run, &reading_of_step(3)).wait().unwrap();
    }
    let stored = journal.load_run(run).unwrap();
    assert_eq!(stored.readings, [touch, again, reading_of_step(3), reading_of_step(3)]);
    assert!(stored.last_reading_stored_at.is_some_and(|kept| kept >= stored.summary.started));
}

#[test]
fn scan_is_stored_once_completely_and_bit_for_bit() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let run = journal.begin_run(&new_run()).wait().unwrap();
    let sample = |number: u32| Reading {
        step: 4,
        repeat: 1,
        sensor: ["x1", "y1", "r1"][number as usize % 3].to_owned(),
        // Temperatures of the row: the same for all of its samples.
        temperatures_c: BTreeMap::from([("table".to_owned(), 61.0 / 3.0)]).into(),
        ..reading_of_step(number)
    };
    // Every flag, with and without a value.
    let samples: Vec<Reading> = (0..12).map(sample).collect();
    let (before, after) = (reading_of_step(2), reading_of_step(5));
    journal.add_reading(run, &before).wait().unwrap();
    journal.add_scan(run, &samples).wait().unwrap();
    journal.add_reading(run, &after).wait().unwrap();
    let error = journal.add_scan(run, &samples[..1]).wait().unwrap_err();
    assert!(matches!(error.fault, StoreFault::DuplicateTouch { step: 4, repeat: 1 }), "{error}");
    let nan = Reading { value_mm: Some(f64::NAN), ..sample(1) };
    let error = journal.add_scan(run, &[Reading { step: 6, ..nan }]).wait().unwrap_err();
    assert!(matches!(error.fault, StoreFault::NotFinite { .. }), "{error}");
    drop(journal);
    let stored = Journal::open(dir.path()).unwrap().load_run(run).unwrap();
    assert_eq!(stored.readings, [&[before][..], &samples, &[after]].concat());
}

#[test]
fn interruptions_are_in_the_plan_and_its_hash() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let run = journal.begin_run(&new_run()).wait().unwrap();
    for gap_s in [12.5, 12.5, 40.0] {
        journal.add_event(run, &RunEvent::Resumed { gap_s }).wait().unwrap();
        journal.add_event(run, &RunEvent::Held { reason: "again".to_owned() }).wait().unwrap();
    }
    let stored = journal.load_run(run).unwrap();
    assert_eq!(stored.plan.interruption_times_s, [12.5, 40.0]);
    assert_eq!(sha256_of_json(&stored.plan).unwrap(), stored.summary.plan_sha256);
}
