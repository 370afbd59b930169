//! Tables of the journal, format by format.
//!
//! Positions of readings are stored bit for bit, in internal units (mm, rad), so that a stored reading gives
//! the same estimate as the live one. Plans, stages, events and estimates are JSON.

use rusqlite::Connection;

use super::StoreFault;

/// The format of the journals that this version writes.
pub(super) const CURRENT_FORMAT: i64 = MIGRATIONS.len() as i64;

/// Migrations, one entry per format. Never change a released entry; add another one. After the migrations the
/// checksum of every row is computed again, and verified before if the journal has checksums.
pub(super) const MIGRATIONS: [&str; 11] = [
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
    // Runs may be `closed` (from this format on the database does not check the states); each touch is unique;
    // readings have a storage time.
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
    // A scan is one row, so that it is stored completely or not at all.
    "
ALTER TABLE readings ADD COLUMN samples TEXT;
",
    // Audit log of requests and their outcomes; rows are never changed.
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
    // Signatures of estimates; rows are never changed.
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
    // Armings of cycles for unattended starts; outcomes of the slots of a schedule; the instant up to which the
    // slots of each schedule are settled.
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
    // Mean of each thermometer during a run, so that a history need not read all readings. It is unknown for
    // earlier runs and for runs that did not end.
    "
ALTER TABLE runs ADD COLUMN temperatures_c TEXT;
",
    // Checksum of each row (`checksum.rs`). Its length is fixed at the insert, so that only one page of a long
    // row is written again.
    "
ALTER TABLE runs ADD COLUMN checksum BLOB NOT NULL DEFAULT x'00000000';
ALTER TABLE steps ADD COLUMN checksum BLOB NOT NULL DEFAULT x'00000000';
ALTER TABLE stages ADD COLUMN checksum BLOB NOT NULL DEFAULT x'00000000';
ALTER TABLE readings ADD COLUMN checksum BLOB NOT NULL DEFAULT x'00000000';
ALTER TABLE events ADD COLUMN checksum BLOB NOT NULL DEFAULT x'00000000';
ALTER TABLE estimates ADD COLUMN checksum BLOB NOT NULL DEFAULT x'00000000';
ALTER TABLE signatures ADD COLUMN checksum BLOB NOT NULL DEFAULT x'00000000';
ALTER TABLE audit ADD COLUMN checksum BLOB NOT NULL DEFAULT x'00000000';
ALTER TABLE armings ADD COLUMN checksum BLOB NOT NULL DEFAULT x'00000000';
ALTER TABLE slots ADD COLUMN checksum BLOB NOT NULL DEFAULT x'00000000';
ALTER TABLE schedules ADD COLUMN checksum BLOB NOT NULL DEFAULT x'00000000';
DROP TRIGGER audit_stands;
CREATE TRIGGER audit_stands BEFORE UPDATE OF seq, at, who, what, why, machine, run, outcome ON audit
    BEGIN SELECT RAISE(ABORT, 'audit stands'); END;
DROP TRIGGER signatures_stand;
CREATE TRIGGER signatures_stand BEFORE UPDATE OF seq, run, at, who, remark, estimate_sha256
    ON signatures BEGIN SELECT RAISE(ABORT, 'signatures stand'); END;
",
    // Values written to controls: the intent before the first write, and the states that follow; rows are never
    // changed.
    "
CREATE TABLE compensations (
    id INTEGER PRIMARY KEY,
    machine TEXT NOT NULL,
    run INTEGER NOT NULL REFERENCES runs (id),
    proposal_sha256 TEXT NOT NULL,
    changes TEXT NOT NULL,
    checksum BLOB NOT NULL DEFAULT x'00000000'
) STRICT;
CREATE TABLE compensation_states (
    seq INTEGER PRIMARY KEY,
    compensation INTEGER NOT NULL REFERENCES compensations (id),
    at TEXT NOT NULL,
    who TEXT NOT NULL,
    state TEXT NOT NULL,
    checksum BLOB NOT NULL DEFAULT x'00000000'
) STRICT;
CREATE INDEX compensations_of ON compensations (machine);
CREATE INDEX states_of_compensations ON compensation_states (compensation);
CREATE TRIGGER compensations_are_kept BEFORE DELETE ON compensations
    BEGIN SELECT RAISE(ABORT, 'compensations are kept'); END;
CREATE TRIGGER compensation_states_are_kept BEFORE DELETE ON compensation_states
    BEGIN SELECT RAISE(ABORT, 'states of compensations are kept'); END;
CREATE TRIGGER compensations_stand BEFORE UPDATE OF id, machine, run, proposal_sha256, changes ON compensations
    BEGIN SELECT RAISE(ABORT, 'compensations are not changed'); END;
CREATE TRIGGER compensation_states_stand BEFORE UPDATE OF seq, compensation, at, who, state ON compensation_states
    BEGIN SELECT RAISE(ABORT, 'states of compensations are not changed'); END;
",
    // Controls have several kinds of values; until now they had one.
    "
ALTER TABLE compensations ADD COLUMN target TEXT NOT NULL DEFAULT 'linuxcnc-trunnion';
DROP TRIGGER compensations_stand;
CREATE TRIGGER compensations_stand BEFORE UPDATE OF id, machine, target, run, proposal_sha256, changes ON compensations
    BEGIN SELECT RAISE(ABORT, 'compensations are not changed'); END;
",
    // The run that has verified a compensation.
    "
ALTER TABLE compensation_states ADD COLUMN verified_by INTEGER REFERENCES runs (id);
DROP TRIGGER compensation_states_stand;
CREATE TRIGGER compensation_states_stand BEFORE UPDATE OF seq, compensation, at, who, state, verified_by
    ON compensation_states
    BEGIN SELECT RAISE(ABORT, 'states of compensations are not changed'); END;
",
];

/// An empty journal of format `format`, in memory.
pub(super) fn empty_journal_in_memory(format: i64) -> Result<Connection, StoreFault> {
    let connection = Connection::open_in_memory()?;
    for (migration, _) in MIGRATIONS.iter().zip(0..format) {
        connection.execute_batch(migration)?;
    }
    Ok(connection)
}

/// Format that the file states; 0 for an empty file.
pub(super) fn format_version(connection: &Connection) -> Result<i64, StoreFault> {
    Ok(connection.pragma_query_value(None, "user_version", |row| row.get(0))?)
}
