//! How the journal's file is opened. A file that is refused stays as it is, byte for byte.

use std::fs;
use std::path::Path;
use std::thread::sleep;
use std::time::{Duration, Instant};

use rusqlite::config::DbConfig;
use rusqlite::{Connection, OpenFlags};

use super::{Fault, checksum, identity, migration, schema};

/// How long a writer waits for another process that writes.
const PATIENCE: Duration = Duration::from_secs(10);
/// How long a process that brings an older journal up to date waits for others to close it.
const PATIENCE_FOR_OTHERS: Duration = Duration::from_secs(1);
const RETRY: Duration = Duration::from_millis(5);

/// The writing connection: write-ahead log, synced at every commit, foreign keys, tables as known.
pub(super) fn open_writer(path: &Path) -> Result<Connection, Fault> {
    let mut connection = patiently(PATIENCE_FOR_OTHERS, || open_sound(path))?;
    connection.pragma_update(None, "synchronous", "FULL")?;
    // Half a megabyte: a journal grows for years, and what holds its pages should not.
    connection.pragma_update(None, "cache_size", -512)?;
    // Off while tables are made anew: what refers to one stays as it is.
    connection.pragma_update(None, "foreign_keys", false)?;
    migration::migrate(&mut connection, path)?;
    connection.pragma_update(None, "foreign_keys", true)?;
    let mode = patiently(PATIENCE, || journal_mode(&connection, "WAL"))?;
    if mode != "wal" {
        return Err(Fault::NoLog { mode });
    }
    checksum::add_triggers(&connection)?;
    Ok(connection)
}

/// A connection to a journal that is accepted. Of an older one it is the only connection: a process of an older
/// version would write rows without checksums into the new tables.
fn open_sound(path: &Path) -> Result<Connection, Fault> {
    let (connection, format) = open_unchanged(path, OpenFlags::default())?;
    if format >= identity::FIRST_MARKED {
        checksum::verify_heads(&connection)?;
    }
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, false)?;
    if format < schema::KNOWN {
        // SQLite leaves the write-ahead log only where no other connection is open.
        journal_mode(&connection, "DELETE")?;
    }
    Ok(connection)
}

/// A connection that changes nothing, to a journal that no connection of this process may have open. Also answers
/// with its format.
///
/// It may write: SQLite leaves files beside the journal if the last connection may only read.
pub(super) fn open_source(path: &Path) -> Result<(Connection, i64), Fault> {
    open_unchanged(path, OpenFlags::default() & !OpenFlags::SQLITE_OPEN_CREATE)
}

/// A reading connection, for one query, while a writing connection is open.
pub(super) fn open_reader(path: &Path) -> Result<Connection, Fault> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let connection = Connection::open_with_flags(path, flags)?;
    connection.busy_timeout(PATIENCE)?;
    checksum::add_function(&connection)?;
    Ok(connection)
}

/// A connection to a journal, or to an empty file, and the format. SQLite would write a log that a killed process
/// has left into the database when the connection is closed: not before the file is accepted.
fn open_unchanged(path: &Path, flags: OpenFlags) -> Result<(Connection, i64), Fault> {
    let mut log = path.as_os_str().to_owned();
    log.push("-wal");
    let has_log = fs::metadata(log).is_ok_and(|log| log.len() > 0);
    let connection = Connection::open_with_flags(path, flags)?;
    connection.busy_timeout(PATIENCE)?;
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, has_log)?;
    checksum::add_function(&connection)?;
    let format = patiently(PATIENCE, || identity::identify(&connection))?;
    Ok((connection, format))
}

fn journal_mode(connection: &Connection, mode: &str) -> Result<String, Fault> {
    Ok(connection.pragma_update_and_check(None, "journal_mode", mode, |row| row.get(0))?)
}

/// Tries again where SQLite reports a file as busy without waiting for `busy_timeout`: two connections switch the
/// journal mode at once.
fn patiently<T>(patience: Duration, attempt: impl Fn() -> Result<T, Fault>) -> Result<T, Fault> {
    let until = Instant::now() + patience;
    loop {
        match attempt() {
            Err(Fault::Busy) if Instant::now() < until => sleep(RETRY),
            ended => return ended,
        }
    }
}
