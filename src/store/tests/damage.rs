//! Files that are no journal, or a damaged one, are refused with their path and never changed.

use std::collections::BTreeMap;
use std::path::Path;

use jiff::Timestamp;
use rusqlite::Connection;

use super::{estimate_with_value, new_run, plan_stage, plan_step, reading_of_step};
use crate::store::*;
use machine::record::event::RunEvent;

const JOURNAL_FILE_NAME: &str = "journal.sqlite";

/// All files in `dir` by name. `-shm` contains locks of connections and no data.
fn file_contents(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    let all = std::fs::read_dir(dir).unwrap().map(|file| file.unwrap());
    let named = all.map(|file| (file.file_name().into_string().unwrap(), file.path()));
    let data = named.filter(|(name, _)| !name.ends_with("-shm"));
    data.map(|(name, path)| (name, std::fs::read(path).unwrap())).collect()
}

/// Checks that opening and `backup` both refuse `dir` with a message that contains all of `words`, and that no
/// file changes.
fn assert_journal_refused_and_unchanged(dir: &Path, words: &[&str]) {
    let (before, to) = (file_contents(dir), tempfile::tempdir().unwrap());
    let opened = Journal::open(dir).map(drop).unwrap_err();
    assert_eq!(file_contents(dir), before, "opening: {opened}");
    let copied = backup(dir, &to.path().join("copy.sqlite")).unwrap_err();
    assert_eq!(file_contents(dir), before, "backup: {copied}");
    assert_eq!(file_contents(to.path()), BTreeMap::new(), "{copied}");
    let path = dir.join(JOURNAL_FILE_NAME).display().to_string();
    for error in [opened, copied] {
        let told = format!("{error} {}", error.remedy());
        assert!(words.iter().chain([&path.as_str()]).all(|word| told.contains(word)), "{told}");
    }
}

/// A database of another program, made by these statements.
fn foreign_database(statements: &str) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    Connection::open(dir.path().join(JOURNAL_FILE_NAME)).unwrap().execute_batch(statements).unwrap();
    dir
}

#[test]
fn database_of_another_program_is_refused_unchanged() {
    let foreign_table = "CREATE TABLE bookmarks (id INTEGER PRIMARY KEY, url TEXT);
                 INSERT INTO bookmarks (url) VALUES ('example.org');";
    let names_of_ours = "CREATE TABLE runs (id INTEGER PRIMARY KEY, km REAL);
                         CREATE TABLE steps (run INTEGER, count INTEGER);";
    for statements in [
        foreign_table.to_owned(),
        format!("PRAGMA journal_mode = WAL; {foreign_table}"),
        format!("PRAGMA user_version = 1; {foreign_table}"),
        format!("PRAGMA user_version = 4; {names_of_ours}"),
        format!("PRAGMA user_version = 7; PRAGMA journal_mode = WAL; {names_of_ours}"),
        format!("PRAGMA user_version = 99; {foreign_table}"),
        "PRAGMA application_id = 252006673;".to_owned(),
        format!("PRAGMA application_id = 252006673; PRAGMA user_version = 1; {foreign_table}"),
    ] {
        let dir = foreign_database(&statements);
        assert_journal_refused_and_unchanged(dir.path(), &["not a journal of trued", "--state"]);
    }
}

/// The log of a killed program is not copied into its database.
#[test]
fn foreign_database_with_write_ahead_log_is_refused_unchanged() {
    let (dir, copy) = (foreign_database("PRAGMA journal_mode = WAL"), tempfile::tempdir().unwrap());
    let open = Connection::open(dir.path().join(JOURNAL_FILE_NAME)).unwrap();
    open.execute_batch("CREATE TABLE bookmarks (url TEXT)").unwrap();
    for name in [JOURNAL_FILE_NAME, "journal.sqlite-wal", "journal.sqlite-shm"] {
        std::fs::copy(dir.path().join(name), copy.path().join(name)).unwrap();
    }
    assert!(!file_contents(copy.path())["journal.sqlite-wal"].is_empty());
    assert_journal_refused_and_unchanged(copy.path(), &["not a journal of trued"]);
}

#[test]
fn empty_file_becomes_a_journal() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join(JOURNAL_FILE_NAME), "").unwrap();
    Journal::open(dir.path()).unwrap().begin_run(&new_run()).wait().unwrap();
}

/// A journal with rows in each of its tables.
fn journal_with_rows_in_each_table() -> (tempfile::TempDir, RunId) {
    let dir = tempfile::tempdir().unwrap();
    let journal = Journal::open(dir.path()).unwrap();
    let run = journal.begin_run(&new_run()).wait().unwrap();
    journal.add_stage(run, &plan_stage(0, vec![0, 1]), &[plan_step(0), plan_step(1)]).wait().unwrap();
    journal.add_reading(run, &reading_of_step(0)).wait().unwrap();
    let sample = |number| Reading { step: 1, repeat: 0, ..reading_of_step(number) };
    journal.add_scan(run, &[sample(1), sample(2)]).wait().unwrap();
    journal.add_event(run, &RunEvent::Held { reason: "Ctrl-C".to_owned() }).wait().unwrap();
    let estimate_sha256 = journal.add_estimate(run, &estimate_with_value(0.1)).wait().unwrap();
    let (who, remark) = ("Ada".to_owned(), "as ever".to_owned());
    journal.add_signature(run, &EstimateSignature { who, remark, estimate_sha256 }).wait().unwrap();
    let now = Timestamp::now();
    let (machine, schedule, why) = ("mill".to_owned(), "weekly".to_owned(), String::new());
    let arming = Arming {
        machine: machine.clone(),
        cycle: 1,
        who: "Ada".to_owned(),
        why: why.clone(),
        armed: now,
        until: now + std::time::Duration::from_secs(3600),
        ended: None,
        broken_by_run: None,
    };
    journal.arm_cycle(&arming).wait().unwrap();
    journal.register_schedules("mill", vec![(schedule.clone(), "0 6 * * 1".to_owned())], now).wait().unwrap();
    let slot = ScheduleSlot { machine, schedule, cycle: 1, at: now, outcome: SlotOutcome::Started, why, run: 0 };
    assert!(journal.store_slot(&slot).wait().unwrap());
    (dir, run)
}

/// Rows that the program itself has written and changed are sound.
#[test]
fn rows_changed_by_the_program_keep_valid_checksums() {
    let (dir, run) = journal_with_rows_in_each_table();
    let journal = Journal::open(dir.path()).unwrap();
    journal.set_state(run, RunState::Held).wait().unwrap();
    journal.set_state(run, RunState::Running).wait().unwrap();
    journal.add_event(run, &RunEvent::Resumed { gap_s: 12.5 }).wait().unwrap();
    journal.set_state(run, RunState::Finished).wait().unwrap();
    journal.remove_scans(run).unwrap();
    assert_eq!(journal.disarm_cycles("mill", None, "Ada", "").wait().unwrap(), 1);
    let slot = journal.newest_slots("mill", 1).unwrap().remove(0);
    assert!(journal.store_slot(&ScheduleSlot { outcome: SlotOutcome::Ran, run: run.0, ..slot }).wait().unwrap());
    let other = journal.begin_run(&new_run()).wait().unwrap();
    let lock = MachineLock::acquire(dir.path(), "mill").unwrap();
    assert_eq!(journal.mark_running_runs_interrupted(&lock).wait().unwrap(), [other]);
    drop(journal);
    backup(dir.path(), &dir.path().join("copy.sqlite")).unwrap();
    assert!(Journal::open(dir.path()).unwrap().load_run(run).is_ok());
}

/// One changed value in a row of each table, as by a failing disk. Page and number stay well-formed.
const DAMAGING_ROW_UPDATES: [(&str, &str, bool); 12] = [
    ("runs", "started = replace(started, 'T', ' ')", true),
    ("runs", "state = 'closed'", true),
    ("audit", "outcome = 'dome'", true),
    ("armings", "cycle = 2", true),
    ("slots", "outcome = 'missed'", true),
    ("schedules", "calendar = '0 7 * * 1'", true),
    ("steps", "step = replace(step, '30.0', '90.0')", false),
    ("stages", "stage = replace(stage, '[0,1]', '[0,3]')", false),
    ("readings", "y_mm = y_mm + 0.125", false),
    ("events", "event = replace(event, 'Ctrl-C', 'Ctrl-D')", false),
    ("estimates", "estimate = replace(estimate, '\"k\":2.0', '\"k\":3.0')", false),
    ("signatures", "who = 'Eve'", false),
];

/// `backup` and every reader of the row refuse it. Opening refuses it if the row belongs to no single run.
#[test]
fn damaged_row_is_refused() {
    let (sound, run) = journal_with_rows_in_each_table();
    for (table, change, is_verified_at_opening) in DAMAGING_ROW_UPDATES {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(JOURNAL_FILE_NAME);
        std::fs::copy(sound.path().join(JOURNAL_FILE_NAME), &path).unwrap();
        let raw = Connection::open(&path).unwrap();
        raw.execute_batch(&format!(
            "DROP TRIGGER audit_stands; DROP TRIGGER signatures_stand; UPDATE {table} SET {change};
             CREATE TRIGGER audit_stands BEFORE UPDATE ON audit BEGIN SELECT 1; END;
             CREATE TRIGGER signatures_stand BEFORE UPDATE ON signatures BEGIN SELECT 1; END;"
        ))
        .unwrap();
        drop(raw);
        let row = format!("table {table}");
        if is_verified_at_opening {
            assert_journal_refused_and_unchanged(dir.path(), &["damaged", &row]);
            continue;
        }
        let before = file_contents(dir.path());
        let to = dir.path().join("copy.sqlite");
        let copied = backup(dir.path(), &to).unwrap_err().to_string();
        assert!(copied.contains("damaged") && copied.contains(&row), "{copied}");
        assert_eq!(file_contents(dir.path()), before, "{table}");
        let read = Journal::open(dir.path()).unwrap().load_run(run).unwrap_err().to_string();
        assert!(read.contains("damaged") && read.contains(&row), "{read}");
    }
}

/// A changed byte of the file, and missing pages.
#[test]
fn damaged_file_is_refused_unchanged() {
    let (sound, _) = journal_with_rows_in_each_table();
    let sound = std::fs::read(sound.path().join(JOURNAL_FILE_NAME)).unwrap();
    let find = |text: &str| sound.windows(text.len()).position(|some| some == text.as_bytes());
    let changed = |at: usize, byte: u8| {
        let mut bytes = sound.clone();
        bytes[at] = byte;
        bytes
    };
    let config = find("[machine]\nname").unwrap();
    // Byte 63 is part of the format number in the header of the file.
    for damaged in [changed(config + 1, b'x'), changed(63, 3), sound[..sound.len() / 2].to_vec()] {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join(JOURNAL_FILE_NAME), damaged).unwrap();
        assert_journal_refused_and_unchanged(dir.path(), &["damaged"]);
    }
}

/// Damaged estimates in the list of runs and in trends.
#[test]
fn damaged_estimate_is_an_error_in_result_queries() {
    let (dir, run) = journal_with_rows_in_each_table();
    let journal = Journal::open(dir.path()).unwrap();
    journal.set_state(run, RunState::Finished).wait().unwrap();
    assert!(journal.newest_measured_runs("mill").unwrap().newest_result.is_some());
    let raw = Connection::open(dir.path().join(JOURNAL_FILE_NAME)).unwrap();
    let change = "UPDATE estimates SET estimate = replace(estimate, '\"value\":0.1', '\"value\":0.3')";
    raw.execute(change, []).unwrap();
    assert!(matches!(journal.newest_measured_runs("mill").unwrap_err().fault, StoreFault::Damaged(_)));
    let all = journal
        .visit_finished_run_results("mill", 9, EstimateSelection::Last, |_| panic!("a damaged estimate was read"));
    assert!(matches!(all.unwrap_err().fault, StoreFault::Damaged(_)));
}
