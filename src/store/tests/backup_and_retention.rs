//! Backups, older versions, and the removal of old samples.

use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};

use jiff::Timestamp;
use rusqlite::Connection;

use super::{estimate_with_value, new_run, reading_of_step};
use crate::store::*;
use machine::record::event::RunEvent;

fn file_names(dir: &Path) -> Vec<String> {
    let files = std::fs::read_dir(dir).unwrap();
    let mut names: Vec<_> = files.map(|file| file.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// A copy made while a run writes is complete and contains at least what was acknowledged before.
#[test]
fn backup_is_complete_during_writes() {
    let (dir, to) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let journal = Journal::open(dir.path()).unwrap();
    let run = journal.begin_run(&new_run()).wait().unwrap();
    let (acknowledged, end) = (AtomicU32::new(0), AtomicU32::new(u32::MAX));
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for step in (0..).take_while(|step| *step < end.load(Ordering::SeqCst)) {
                journal.add_reading(run, &reading_of_step(step)).wait().unwrap();
                acknowledged.store(step + 1, Ordering::SeqCst);
            }
        });
        for copy in 0..5 {
            while acknowledged.load(Ordering::SeqCst) < 20 * copy {
                std::thread::yield_now();
            }
            let before = acknowledged.load(Ordering::SeqCst) as usize;
            let file = to.path().join(format!("{copy}")).join("journal.sqlite");
            std::fs::create_dir(file.parent().unwrap()).unwrap();
            assert_eq!(backup(dir.path(), &file).unwrap().newest_run, Some(run));
            assert_eq!(file_names(file.parent().unwrap()), ["journal.sqlite"]);
            let copied = Journal::open(file.parent().unwrap()).unwrap().load_run(run).unwrap();
            assert!(copied.readings.len() >= before, "{} of {before}", copied.readings.len());
            assert!(copied.readings.iter().zip(0..).all(|(kept, step)| *kept == reading_of_step(step)));
        }
        end.store(0, Ordering::SeqCst);
    });
}

#[test]
fn backup_overwrites_no_file_and_leaves_no_partial_file() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("copy.sqlite");
    let missing = backup(dir.path(), &file).unwrap_err();
    assert!(matches!(missing.fault, StoreFault::JournalMissing), "{missing}");
    let state = dir.path().join("state");
    drop(Journal::open(&state).unwrap());
    std::fs::write(dir.path().join("copy.sqlite.part"), "half of one").unwrap();
    assert_eq!(backup(&state, &file).unwrap(), BackupContent { newest_run: None, has_row_checksums: true });
    let exists = backup(&state, &file).unwrap_err();
    assert!(matches!(exists.fault, StoreFault::FileExists), "{exists}");
    assert_eq!(file_names(dir.path()), ["copy.sqlite", "state"]);
    // Invalid pages: the copy is verified before it gets its name.
    Journal::open(&state).unwrap().begin_run(&new_run()).wait().unwrap();
    let journal = state.join("journal.sqlite");
    let mut bytes = std::fs::read(&journal).unwrap();
    bytes[4096 + 8..3 * 4096].fill(0xa5);
    std::fs::write(&journal, bytes).unwrap();
    let damaged = backup(&state, &dir.path().join("second.sqlite")).unwrap_err();
    assert!(matches!(damaged.fault, StoreFault::Damaged(_)), "{damaged}");
    assert_eq!(file_names(dir.path()), ["copy.sqlite", "state"]);
}

/// One unchanged copy of a journal of the first version is kept.
#[test]
fn one_copy_of_the_journal_before_migration_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let old = Connection::open(dir.path().join("journal.sqlite")).unwrap();
    old.execute_batch(include_str!("../../../tests/data/journal_version_1.sql")).unwrap();
    drop(old);
    drop(Journal::open(dir.path()).unwrap());
    drop(Journal::open(dir.path()).unwrap());
    let kept: Vec<_> = file_names(dir.path()).into_iter().filter(|name| name.starts_with("journal-")).collect();
    let [kept] = kept.as_slice() else { panic!("{kept:?}") };
    assert!(kept.starts_with("journal-v1-2") && kept.ends_with("Z.sqlite"), "{kept}");
    let kept = Connection::open(dir.path().join(kept)).unwrap();
    let number = |ask: &str| kept.query_row(ask, [], |row| row.get::<_, i64>(0)).unwrap();
    assert_eq!(number("PRAGMA user_version"), 1);
    assert_eq!(number("SELECT count(*) FROM readings"), 1);
    // The copy has the old schema: it still checks the states of the first version.
    assert!(kept.execute("UPDATE runs SET state = 'closed'", []).is_err());
}

/// The program was killed after it copied the old journal, and restarts the migration in the same second.
#[test]
fn migration_keeps_an_earlier_copy_of_the_same_second() {
    let dir = tempfile::tempdir().unwrap();
    let old = Connection::open(dir.path().join("journal.sqlite")).unwrap();
    old.execute_batch(include_str!("../../../tests/data/journal_version_1.sql")).unwrap();
    drop(old);
    let (now, kept) = (Timestamp::now(), "kept before the program was killed");
    for second in 0..30 {
        let at = now + std::time::Duration::from_secs(second);
        let name = at.strftime("journal-v1-%Y%m%dT%H%M%SZ.sqlite").to_string();
        std::fs::write(dir.path().join(name), kept).unwrap();
    }
    assert_eq!(Journal::open(dir.path()).unwrap().runs().unwrap().len(), 1);
    let all: Vec<_> = file_names(dir.path()).into_iter().filter(|name| name.starts_with("journal-v1-")).collect();
    let is_older = |name: &&String| std::fs::read(dir.path().join(name)).unwrap() == kept.as_bytes();
    assert_eq!((all.len(), all.iter().filter(is_older).count()), (31, 30), "{all:?}");
}

#[test]
fn new_journal_makes_no_copy_of_an_old_version() {
    let dir = tempfile::tempdir().unwrap();
    drop(Journal::open(dir.path()).unwrap());
    assert!(file_names(dir.path()).iter().all(|name| name.starts_with("journal.sqlite")));
}

fn run_with_three_scans(journal: &Journal, state: RunState, has_estimate: bool) -> RunId {
    let run = journal.begin_run(&new_run()).wait().unwrap();
    journal.add_reading(run, &reading_of_step(0)).wait().unwrap();
    for step in [1, 3, 5] {
        journal.add_scan(run, &[reading_of_step(step), reading_of_step(step)]).wait().unwrap();
    }
    if has_estimate {
        journal.add_estimate(run, &estimate_with_value(0.1)).wait().unwrap();
    }
    journal.set_state(run, state).wait().unwrap();
    run
}

#[test]
fn only_samples_of_finished_runs_with_estimate_are_removed() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let old = run_with_three_scans(&journal, RunState::Finished, true);
    let kept = [
        run_with_three_scans(&journal, RunState::Finished, false),
        run_with_three_scans(&journal, RunState::Held, true),
        run_with_three_scans(&journal, RunState::Interrupted, false),
        run_with_three_scans(&journal, RunState::NotResumable, true),
    ];
    let audit = AuditEntry {
        who: "Ada".to_owned(),
        what: "start of cycle 1".to_owned(),
        why: String::new(),
        machine: "mill".to_owned(),
        run: old.0,
        outcome: "accepted".to_owned(),
    };
    journal.add_audit_entry(&audit).wait().unwrap();
    let before: Vec<_> = kept.iter().map(|run| journal.load_run(*run).unwrap()).collect();
    let was = journal.load_run(old).unwrap();
    let now = Timestamp::now();
    let earlier = now - std::time::Duration::from_secs(3600);
    assert!(journal.finished_runs_ended_before(earlier).unwrap().is_empty());
    assert_eq!(journal.finished_runs_ended_before(now).unwrap(), [old]);
    assert_eq!(journal.remove_scans(old).unwrap(), 3);
    assert_eq!(journal.remove_scans(old).unwrap(), 0);
    let is = journal.load_run(old).unwrap();
    assert_eq!(is.readings, [reading_of_step(0)]);
    assert_eq!((&is.estimates, &is.plan, &is.machine_file_text), (&was.estimates, &was.plan, &was.machine_file_text));
    let told: Vec<_> = is.events.into_iter().map(|(_, event)| event).collect();
    assert_eq!(told, [RunEvent::SamplesRemoved { scans: 3 }]);
    let after: Vec<_> = kept.iter().map(|run| journal.load_run(*run).unwrap()).collect();
    assert_eq!(before, after);
    assert_eq!(journal.audit_entries(None, 9).unwrap().len(), 1);
}

/// Pages are newest first, without duplicates or omissions.
#[test]
fn audit_log_pages_are_newest_first_and_complete() {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let text = String::new;
    let (who, why, machine, outcome) = (text(), text(), text(), text());
    let mut audit = AuditEntry { who, what: text(), why, machine, run: 0, outcome };
    for number in 0..7 {
        audit.what = number.to_string();
        journal.add_audit_entry(&audit).wait().unwrap();
    }
    let (mut pages, mut before) = (Vec::new(), None);
    loop {
        let page = journal.audit_entries(before, 3).unwrap();
        let Some(last) = page.last() else { break };
        before = Some(last.seq);
        pages.push(page.iter().map(|one| one.entry.what.clone()).collect::<Vec<_>>().concat());
    }
    assert_eq!(pages, ["654", "321", "0"]);
}
