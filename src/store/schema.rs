//! The journal's tables, and how a connection is opened.
//!
//! Positions of readings are kept bit for bit, in internal units (mm, rad), so that a stored
//! reading gives the same estimate as the live one. Plans, stages, events and estimates are JSON.

use std::path::Path;
use std::thread::sleep;
use std::time::{Duration, Instant};

use jiff::Timestamp;
use rusqlite::{Connection, OpenFlags, TransactionBehavior};

use super::{Fault, snapshot};

/// One entry a version; never change one that was released, add another.
const MIGRATIONS: [&str; 7] = [
    "
CREATE TABLE runs (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    started TEXT NOT NULL,
    ended TEXT,
    method TEXT NOT NULL,
    machine TEXT NOT NULL,
    state TEXT NOT NULL
        CHECK (state IN ('running', 'held', 'finished', 'failed', 'interrupted')),
    program_version TEXT NOT NULL,
    config TEXT NOT NULL,
    config_sha256 TEXT NOT NULL,
    plan_head TEXT NOT NULL,
    plan_sha256 TEXT NOT NULL
) STRICT;
CREATE TABLE steps (
    run INTEGER NOT NULL REFERENCES runs (id),
    id INTEGER NOT NULL,
    step TEXT NOT NULL,
    PRIMARY KEY (run, id)
) STRICT;
CREATE TABLE stages (
    seq INTEGER PRIMARY KEY,
    run INTEGER NOT NULL REFERENCES runs (id),
    stage TEXT NOT NULL
) STRICT;
CREATE TABLE readings (
    seq INTEGER PRIMARY KEY,
    run INTEGER NOT NULL REFERENCES runs (id),
    step INTEGER NOT NULL,
    repeat INTEGER NOT NULL,
    x_mm REAL, y_mm REAL, z_mm REAL, a_rad REAL, b_rad REAL, c_rad REAL, s_rad REAL,
    value_mm REAL,
    sensor TEXT NOT NULL,
    t_s REAL NOT NULL,
    flag TEXT NOT NULL,
    temperatures_c TEXT NOT NULL
) STRICT;
CREATE TABLE events (
    seq INTEGER PRIMARY KEY,
    run INTEGER NOT NULL REFERENCES runs (id),
    at TEXT NOT NULL,
    event TEXT NOT NULL
) STRICT;
CREATE TABLE estimates (
    seq INTEGER PRIMARY KEY,
    run INTEGER NOT NULL REFERENCES runs (id),
    made TEXT NOT NULL,
    estimate TEXT NOT NULL,
    sha256 TEXT NOT NULL,
    program_version TEXT NOT NULL
) STRICT;
CREATE INDEX stages_of ON stages (run);
CREATE INDEX readings_of ON readings (run);
CREATE INDEX events_of ON events (run);
CREATE INDEX estimates_of ON estimates (run);
",
    // A run may be `closed` (the program alone knows the states from here on); no touch stands
    // twice; readings know when they were kept.
    "
CREATE TABLE runs_anew (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    started TEXT NOT NULL,
    ended TEXT,
    method TEXT NOT NULL,
    machine TEXT NOT NULL,
    state TEXT NOT NULL,
    program_version TEXT NOT NULL,
    config TEXT NOT NULL,
    config_sha256 TEXT NOT NULL,
    plan_head TEXT NOT NULL,
    plan_sha256 TEXT NOT NULL
) STRICT;
INSERT INTO runs_anew SELECT * FROM runs;
DROP TABLE runs;
ALTER TABLE runs_anew RENAME TO runs;
ALTER TABLE readings ADD COLUMN kept TEXT;
CREATE UNIQUE INDEX touches_once ON readings (run, step, repeat) WHERE value_mm IS NULL;
",
    // A scan is one row: all of its samples, or none.
    "
ALTER TABLE readings ADD COLUMN samples TEXT;
",
    // Who asked for what, and what came of it; nothing of it is ever changed.
    "
CREATE TABLE audit (
    seq INTEGER PRIMARY KEY,
    at TEXT NOT NULL,
    who TEXT NOT NULL,
    what TEXT NOT NULL,
    why TEXT NOT NULL,
    machine TEXT NOT NULL,
    run INTEGER NOT NULL,
    outcome TEXT NOT NULL
) STRICT;
CREATE TRIGGER audit_is_kept BEFORE DELETE ON audit BEGIN SELECT RAISE(ABORT, 'audit is kept'); END;
CREATE TRIGGER audit_stands BEFORE UPDATE ON audit BEGIN SELECT RAISE(ABORT, 'audit stands'); END;
",
    // Who answers for an estimate; nothing of it is ever changed.
    "
CREATE TABLE signatures (
    seq INTEGER PRIMARY KEY,
    run INTEGER NOT NULL REFERENCES runs (id),
    at TEXT NOT NULL,
    who TEXT NOT NULL,
    remark TEXT NOT NULL,
    estimate_sha256 TEXT NOT NULL
) STRICT;
CREATE INDEX signatures_of ON signatures (run);
CREATE TRIGGER signatures_are_kept BEFORE DELETE ON signatures
    BEGIN SELECT RAISE(ABORT, 'signatures are kept'); END;
CREATE TRIGGER signatures_stand BEFORE UPDATE ON signatures
    BEGIN SELECT RAISE(ABORT, 'signatures stand'); END;
",
    // Who let a cycle start while nobody is there; what became of each instant of a schedule; up to
    // which instant each schedule was seen to.
    "
CREATE TABLE armings (
    seq INTEGER PRIMARY KEY,
    machine TEXT NOT NULL,
    cycle INTEGER NOT NULL,
    who TEXT NOT NULL,
    why TEXT NOT NULL,
    armed TEXT NOT NULL,
    until TEXT NOT NULL,
    after_event INTEGER NOT NULL,
    ended TEXT,
    ended_why TEXT
) STRICT;
CREATE TABLE slots (
    machine TEXT NOT NULL,
    schedule TEXT NOT NULL,
    at TEXT NOT NULL,
    cycle INTEGER NOT NULL,
    decided TEXT NOT NULL,
    outcome TEXT NOT NULL,
    why TEXT NOT NULL,
    run INTEGER NOT NULL,
    PRIMARY KEY (machine, schedule, at)
) STRICT;
CREATE TABLE schedules (
    machine TEXT NOT NULL,
    schedule TEXT NOT NULL,
    calendar TEXT NOT NULL,
    seen TEXT NOT NULL,
    PRIMARY KEY (machine, schedule)
) STRICT;
",
    // The mean of what each thermometer said during a run, so that a history need not read all readings.
    // Of runs before, and of those that did not come to their end, nothing is known.
    "
ALTER TABLE runs ADD COLUMN temperatures_c TEXT;
",
];

/// How long a writer waits for another process that writes.
const PATIENCE: Duration = Duration::from_secs(10);
const RETRY: Duration = Duration::from_millis(5);

/// The writing connection: write-ahead log, synced at every commit, foreign keys, tables as known.
pub(super) fn open_writer(path: &Path) -> Result<Connection, Fault> {
    let mut connection = Connection::open(path)?;
    connection.busy_timeout(PATIENCE)?;
    let mode = write_ahead(&connection)?;
    if mode != "wal" {
        return Err(Fault::NoLog { mode });
    }
    connection.pragma_update(None, "synchronous", "FULL")?;
    // Half a megabyte: a journal grows for years, and what holds its pages should not.
    connection.pragma_update(None, "cache_size", -512)?;
    // Off while tables are made anew: what refers to one stays as it is.
    connection.pragma_update(None, "foreign_keys", false)?;
    migrate(&mut connection, path)?;
    connection.pragma_update(None, "foreign_keys", true)?;
    Ok(connection)
}

/// Switches the journal mode. Where two connections switch a new file at once, SQLite reports it as busy
/// without waiting for `busy_timeout`, so this tries again.
fn write_ahead(connection: &Connection) -> Result<String, Fault> {
    let until = Instant::now() + PATIENCE;
    loop {
        let mode =
            connection.pragma_update_and_check(None, "journal_mode", "WAL", |row| row.get(0));
        match mode.map_err(Fault::from) {
            Err(Fault::Busy) if Instant::now() < until => sleep(RETRY),
            mode => return mode,
        }
    }
}

/// A reading connection, for one look.
pub(super) fn open_reader(path: &Path) -> Result<Connection, Fault> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let connection = Connection::open_with_flags(path, flags)?;
    connection.busy_timeout(PATIENCE)?;
    Ok(connection)
}

/// Bring the tables up to date in one transaction, also when several processes try at once. What was
/// there before is kept.
fn migrate(connection: &mut Connection, path: &Path) -> Result<(), Fault> {
    let known = MIGRATIONS.len() as i64;
    if version(connection)? == known {
        return Ok(());
    }
    let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
    let found = version(&transaction)?;
    let missing = usize::try_from(found).ok().and_then(|done| MIGRATIONS.get(done..));
    let missing = missing.ok_or(Fault::Newer { found, known })?;
    if found > 0 && !missing.is_empty() {
        keep_version(path, found)?;
    }
    for migration in missing {
        transaction.execute_batch(migration)?;
    }
    transaction.pragma_update(None, "user_version", known)?;
    Ok(transaction.commit()?)
}

/// The journal at `path` as it is before it is brought up from version `found`, kept beside it.
fn keep_version(path: &Path, found: i64) -> Result<(), Fault> {
    let now = Timestamp::now().strftime("%Y%m%dT%H%M%SZ");
    let kept = path.with_file_name(format!("journal-v{found}-{now}.sqlite"));
    snapshot::keep(&open_reader(path)?, &kept)
}

fn version(connection: &Connection) -> Result<i64, Fault> {
    Ok(connection.pragma_query_value(None, "user_version", |row| row.get(0))?)
}
