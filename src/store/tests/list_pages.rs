//! Pages of long lists agree with the whole list.

use super::{estimate_with_value, new_run, reading_of_step};
use crate::store::*;
use machine::record::reading::Reading;

/// With touches and scans in one run, any page equals the same part of the whole.
#[test]
fn pages_of_readings_agree_with_all_readings() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let run = journal.begin_run(&new_run()).wait().unwrap();
    let scan = |step: u32, count: u32| -> Vec<Reading> {
        let (first, samples) = (reading_of_step(step), (0..count).map(|number| reading_of_step(number + 20)));
        samples
            .map(|sample| Reading { step, repeat: first.repeat, temperatures_c: Default::default(), ..sample })
            .collect()
    };
    journal.add_reading(run, &reading_of_step(0)).wait().unwrap();
    journal.add_scan(run, &scan(1, 7)).wait().unwrap();
    journal.add_reading(run, &reading_of_step(2)).wait().unwrap();
    journal.add_scan(run, &scan(3, 4)).wait().unwrap();
    let whole = journal.load_run(run).unwrap().readings;
    assert_eq!(whole.len(), 13);
    for after in 0..15 {
        for most in 0..15 {
            let (all, some) = journal.count_and_list_readings(run, after, most).unwrap();
            let wanted: Vec<_> = whole.iter().skip(after).take(most).cloned().collect();
            assert!(all == 13 && some == wanted, "{after} {most}: {some:?}");
        }
    }
    let missing = journal.count_and_list_readings(RunId(7), 0, 1).unwrap_err();
    assert!(matches!(missing.fault, StoreFault::RunNotFound(RunId(7))), "{missing}");
}

/// Finished runs only, with the last identification.
#[test]
fn newest_result_is_of_the_newest_finished_run() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let run = |state| {
        let run = journal.begin_run(&new_run()).wait().unwrap();
        journal.add_estimate(run, &estimate_with_value(run.0 as f64)).wait().unwrap();
        journal.set_state(run, state).wait().unwrap();
        run
    };
    assert_eq!(journal.newest_measured_runs("mill").unwrap(), NewestMeasuredRuns::default());
    let (first, second) = (run(RunState::Finished), run(RunState::Finished));
    run(RunState::Held);
    journal.add_estimate(first, &estimate_with_value(8.0)).wait().unwrap();
    journal.add_estimate(second, &estimate_with_value(9.0)).wait().unwrap();
    let newest = journal.newest_measured_runs("mill").unwrap().newest_result.unwrap();
    assert_eq!((newest.run, newest.parameters[0].value), (second, 9.0));
    assert_eq!(Some(newest.ended), journal.load_run(second).unwrap().summary.ended);
    assert_eq!(journal.newest_measured_runs("lathe").unwrap(), NewestMeasuredRuns::default());
    let held = RunFilter { state: Some(RunState::Held), ..RunFilter::default() };
    assert_eq!(journal.list_runs(held, 9).unwrap().len(), 1);
    let other = RunFilter { machine: Some("lathe"), ..RunFilter::default() };
    assert_eq!(journal.list_runs(other, 9).unwrap(), []);
    let all: Vec<_> = journal.list_runs(RunFilter::default(), 9).unwrap();
    assert_eq!(all.into_iter().rev().collect::<Vec<_>>(), journal.runs().unwrap());
}

/// A run that ended without an estimate has its own state until an estimate is stored, and then replaces the
/// earlier result.
#[test]
fn estimate_finishes_a_measured_run() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let measured = || {
        let run = journal.begin_run(&new_run()).wait().unwrap();
        journal.set_state(run, RunState::NotIdentified).wait().unwrap();
        run
    };
    let (old, first) = (measured(), measured());
    journal.add_estimate(first, &estimate_with_value(1.0)).wait().unwrap();
    let newest = || {
        let NewestMeasuredRuns { newest_result: result, newer_run_without_estimate: not_identified } =
            journal.newest_measured_runs("mill").unwrap();
        (result.map(|newest| newest.run), not_identified)
    };
    assert_eq!(newest(), (Some(first), None));
    let second = measured();
    assert_eq!(newest(), (Some(first), Some(second)));
    assert_eq!(journal.measured_runs_without_estimate("mill").unwrap(), [old, second]);
    assert_eq!(journal.measured_runs_without_estimate("lathe").unwrap(), []);
    let states = || journal.runs().unwrap().iter().map(|run| run.state).collect::<Vec<_>>();
    let (open, done) = (RunState::NotIdentified, RunState::Finished);
    assert_eq!(states(), [open, done, open]);
    let listed = |state| {
        let wanted = RunFilter { state: Some(state), ..RunFilter::default() };
        let runs = journal.list_runs(wanted, 9).unwrap();
        runs.iter().map(|run| run.id).collect::<Vec<_>>()
    };
    assert_eq!((listed(open), listed(done)), (vec![second, old], vec![first]));
    let ended = journal.load_run(second).unwrap().summary.ended;
    journal.add_estimate(second, &estimate_with_value(2.0)).wait().unwrap();
    assert_eq!((newest(), states()), ((Some(second), None), vec![open, done, done]));
    // A later identification does not change the end of the measurement.
    assert_eq!(journal.load_run(second).unwrap().summary.ended, ended);
    assert_eq!(serde_json::to_value(open).unwrap(), open.as_str());
}
