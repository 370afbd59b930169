//! Files in a state directory: journals of other versions, locks, foreign files.

use std::collections::BTreeMap;
use std::path::Path;

use rusqlite::Connection;

use super::{estimate_with_value, new_run, reading_of_step};
use crate::store::*;
use machine::record::reading::Reading;

/// A run of the first version, and a run with thermometers whose mean temperatures cover readings and scans,
/// each over the readings with a value.
#[test]
fn ended_run_has_mean_temperatures_but_older_formats_have_none() {
    let dir = tempfile::tempdir().unwrap();
    let old = Connection::open(dir.path().join("journal.sqlite")).unwrap();
    old.execute_batch(include_str!("../../../tests/data/journal_version_1.sql")).unwrap();
    old.execute("UPDATE runs SET state = 'finished'", []).unwrap();
    drop(old);
    let journal = Journal::open(dir.path()).unwrap();
    let before = journal.runs().unwrap()[0].clone();
    let new = NewRun { plan: journal.load_run(before.id).unwrap().plan, ..new_run() };
    let run = journal.begin_run(&new).wait().unwrap();
    let felt = |step: u32, felt: &[(&str, f64)]| {
        let all: BTreeMap<_, _> = felt.iter().map(|(n, c)| ((*n).to_owned(), *c)).collect();
        Reading { temperatures_c: all.into(), ..reading_of_step(step) }
    };
    journal.add_reading(run, &felt(0, &[("bed", 20.0), ("spindle", 30.0)])).wait().unwrap();
    journal.add_reading(run, &felt(2, &[("bed", 20.5)])).wait().unwrap();
    journal.add_scan(run, &vec![felt(4, &[("bed", 21.75), ("spindle", 31.0)]); 9]).wait().unwrap();
    journal.add_reading(run, &felt(6, &[])).wait().unwrap();
    journal.add_estimate(run, &estimate_with_value(0.1)).wait().unwrap();
    journal.set_state(run, RunState::Held).wait().unwrap();
    let measured = || {
        let mut all = Vec::new();
        journal.visit_finished_run_results(&before.machine, 100, EstimateSelection::Last, |it| all.push(it)).unwrap();
        all
    };
    assert_eq!(measured(), []);
    // The first run is finished as by an older version, the second as by this one.
    journal.add_estimate(before.id, &estimate_with_value(0.1)).wait().unwrap();
    journal.set_state(run, RunState::Finished).wait().unwrap();
    let known = measured();
    let means = known.iter().map(|it| it.temperatures_c.iter().collect::<Vec<_>>());
    let expected = [vec![], vec![("bed", 20.75), ("spindle", 30.5)]];
    assert_eq!(means.collect::<Vec<_>>(), expected);
    // The removal of old samples does not change the means.
    journal.remove_scans(run).unwrap();
    assert_eq!(measured(), known);
}

/// A journal in the format of the first version.
#[test]
fn older_journal_is_migrated() {
    let dir = tempfile::tempdir().unwrap();
    let old = Connection::open(dir.path().join("journal.sqlite")).unwrap();
    old.execute_batch(include_str!("../../../tests/data/journal_version_1.sql")).unwrap();
    drop(old);
    let journal = Journal::open(dir.path()).unwrap();
    let run = journal.runs().unwrap()[0].id;
    let stored = journal.load_run(run).unwrap();
    assert_eq!((stored.readings.len(), stored.last_reading_stored_at), (1, None));
    journal.set_state(run, RunState::NotResumable).wait().unwrap();
    let next = journal.begin_run(&new_run()).wait().unwrap();
    assert!(next > run);
    let error = journal.add_reading(RunId(77), &reading_of_step(0)).wait().unwrap_err();
    assert!(matches!(error.fault, StoreFault::RunNotFound(RunId(77))), "{error}");
}

/// An older program would continue to write rows without checksums.
#[test]
fn older_journal_in_use_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let old = Connection::open(dir.path().join("journal.sqlite")).unwrap();
    old.execute_batch(include_str!("../../../tests/data/journal_version_1.sql")).unwrap();
    assert!(matches!(fault_on_opening(dir.path()), StoreFault::Locked));
    old.execute("UPDATE runs SET state = 'failed'", []).unwrap();
    drop(old);
    assert_eq!(Journal::open(dir.path()).unwrap().runs().unwrap()[0].state, RunState::Failed);
}

#[test]
fn older_journal_is_migrated_by_concurrent_threads() {
    let dir = tempfile::tempdir().unwrap();
    let old = Connection::open(dir.path().join("journal.sqlite")).unwrap();
    old.execute_batch(include_str!("../../../tests/data/journal_version_1.sql")).unwrap();
    drop(old);
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| assert_eq!(Journal::open(dir.path()).unwrap().runs().unwrap().len(), 1));
        }
    });
}

#[test]
fn lock_error_names_the_holder_and_lock_marks_dead_runs_interrupted() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let mill = journal.begin_run(&new_run()).wait().unwrap();
    let held = journal.begin_run(&new_run()).wait().unwrap();
    journal.set_state(held, RunState::Held).wait().unwrap();
    let mut other = new_run();
    other.plan.machine.name = "lathe".to_owned();
    let lathe = journal.begin_run(&other).wait().unwrap();

    let lock = MachineLock::acquire(dir.path(), "mill").unwrap();
    let refused = MachineLock::acquire(dir.path(), "mill").unwrap_err();
    let LockError::MachineInUse { holder: Some(holder), .. } = &refused else { panic!("{refused}") };
    assert_eq!((holder.pid, holder.machine.as_str()), (std::process::id(), "mill"));
    assert!(refused.to_string().contains(&format!("by process {}", std::process::id())));

    assert_eq!(journal.mark_running_runs_interrupted(&lock).wait().unwrap(), [mill]);
    let states: Vec<_> = journal.runs().unwrap().iter().map(|run| (run.id, run.state)).collect();
    assert_eq!(states, [(mill, RunState::Interrupted), (held, RunState::Held), (lathe, RunState::Running)]);
    drop(lock);
    MachineLock::acquire(dir.path(), "mill").unwrap();
}

#[test]
fn machine_names_cannot_leave_the_lock_directory() {
    let dir = tempfile::tempdir().unwrap();
    let names = ["../../mill", "..", "", "a/b", "a-b", "ä".repeat(300).as_str()].map(str::to_owned);
    let locks: Vec<_> = names.iter().map(|name| MachineLock::acquire(dir.path(), name)).collect();
    assert!(locks.iter().all(Result::is_ok), "{locks:?}");
    let files = std::fs::read_dir(dir.path().join("locks")).unwrap().count();
    assert_eq!(files, names.len());
}

#[test]
fn many_threads_open_a_new_journal() {
    // SQLite's own waiting fails about once in fifty rounds.
    (0..20).for_each(|_| open_new_journal_in_threads());
}

fn open_new_journal_in_threads() {
    let dir = tempfile::tempdir().unwrap();
    let opened: Vec<_> = std::thread::scope(|scope| {
        let handles: Vec<_> =
            (0..8).map(|_| scope.spawn(|| Journal::open(dir.path())?.begin_run(&new_run()).wait())).collect();
        handles.into_iter().map(|handle| handle.join().unwrap()).collect()
    });
    for run in &opened {
        assert!(run.is_ok(), "{run:?}");
    }
    assert_eq!(Journal::open(dir.path()).unwrap().runs().unwrap().len(), 8);
}

#[test]
fn unknown_file_is_refused_unchanged_and_newer_format_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("journal.sqlite");
    std::fs::write(&path, "not a database, but a shopping list of some length").unwrap();
    let before = std::fs::read(&path).unwrap();
    assert!(matches!(fault_on_opening(dir.path()), StoreFault::Damaged(_)));
    assert_eq!(std::fs::read(&path).unwrap(), before);

    std::fs::remove_file(&path).unwrap();
    drop(Journal::open(dir.path()).unwrap());
    Connection::open(&path).unwrap().pragma_update(None, "user_version", 99).unwrap();
    assert!(matches!(fault_on_opening(dir.path()), StoreFault::NewerFormat { found: 99, .. }));
}

fn fault_on_opening(dir: &Path) -> StoreFault {
    Journal::open(dir).map(drop).unwrap_err().fault
}
