//! Opening the journal's file. A file that is refused is not changed.

use std::fs;
use std::path::Path;
use std::thread::sleep;
use std::time::{Duration, Instant};

use rusqlite::config::DbConfig;
use rusqlite::{Connection, OpenFlags};

use super::{StoreFault, checksum, format_identification, migration, schema};

/// Maximum wait of any connection for another process that has locked the journal.
const JOURNAL_BUSY_TIMEOUT: Duration = Duration::from_secs(10);
/// Maximum wait of a process that migrates an older journal until other processes have closed it.
const MIGRATION_LOCK_TIMEOUT: Duration = Duration::from_secs(1);
const BUSY_RETRY_INTERVAL: Duration = Duration::from_millis(5);

/// The writing connection: write-ahead log, synced at every commit, foreign keys, current tables.
pub(super) fn open_writer(path: &Path) -> Result<Connection, StoreFault> {
    let mut connection = retry_while_busy(MIGRATION_LOCK_TIMEOUT, || open_accepted_journal(path))?;
    connection.pragma_update(None, "synchronous", "FULL")?;
    // Limits the page cache to half a megabyte, however large the journal is.
    connection.pragma_update(None, "cache_size", -512)?;
    // Off while tables are replaced, so that references to them stay unchanged.
    connection.pragma_update(None, "foreign_keys", false)?;
    migration::migrate(&mut connection, path)?;
    connection.pragma_update(None, "foreign_keys", true)?;
    let mode = retry_while_busy(JOURNAL_BUSY_TIMEOUT, || set_journal_mode(&connection, "WAL"))?;
    if mode != "wal" {
        return Err(StoreFault::NoWriteAheadLog { mode });
    }
    checksum::add_checksum_triggers(&connection)?;
    Ok(connection)
}

/// A connection to an accepted journal. For an older journal it must be the only connection: a process of an
/// older version would write rows without checksums into the new tables.
fn open_accepted_journal(path: &Path) -> Result<Connection, StoreFault> {
    let (connection, format) = open_and_identify_format(path, OpenFlags::default())?;
    if format >= format_identification::FIRST_FORMAT_WITH_APPLICATION_ID {
        checksum::verify_run_heads_and_service_tables(&connection)?;
    }
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, false)?;
    if format < schema::CURRENT_FORMAT {
        // SQLite leaves the write-ahead log only if no other connection is open.
        set_journal_mode(&connection, "DELETE")?;
    }
    Ok(connection)
}

/// Opens an existing journal without changing it; no other connection of this process may have it open. Also
/// returns the journal's format.
///
/// The connection may write: SQLite leaves files beside the journal if the last connection is read-only.
pub(super) fn open_backup_source(path: &Path) -> Result<(Connection, i64), StoreFault> {
    open_and_identify_format(path, OpenFlags::default() & !OpenFlags::SQLITE_OPEN_CREATE)
}

/// A read-only connection for one query while a writing connection is open.
pub(super) fn open_reader(path: &Path) -> Result<Connection, StoreFault> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let connection = Connection::open_with_flags(path, flags)?;
    connection.busy_timeout(JOURNAL_BUSY_TIMEOUT)?;
    checksum::add_checksum_function(&connection)?;
    Ok(connection)
}

/// Opens a journal or an empty file, and returns its format. When the connection is closed, SQLite would copy
/// the log of a killed process into the database; this is disabled until the file is accepted.
fn open_and_identify_format(path: &Path, flags: OpenFlags) -> Result<(Connection, i64), StoreFault> {
    let mut log = path.as_os_str().to_owned();
    log.push("-wal");
    let has_log = fs::metadata(log).is_ok_and(|log| log.len() > 0);
    let connection = Connection::open_with_flags(path, flags)?;
    connection.busy_timeout(JOURNAL_BUSY_TIMEOUT)?;
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, has_log)?;
    checksum::add_checksum_function(&connection)?;
    let format = retry_while_busy(JOURNAL_BUSY_TIMEOUT, || format_identification::identify_format(&connection))?;
    Ok((connection, format))
}

/// Requests a journal mode of SQLite; returns the mode that is then in use, which may be another.
fn set_journal_mode(connection: &Connection, mode: &str) -> Result<String, StoreFault> {
    Ok(connection.pragma_update_and_check(None, "journal_mode", mode, |row| row.get(0))?)
}

/// Retries while SQLite reports the file as busy without waiting for `busy_timeout`, which happens when two
/// connections switch the journal mode at once.
fn retry_while_busy<T>(timeout: Duration, attempt: impl Fn() -> Result<T, StoreFault>) -> Result<T, StoreFault> {
    let until = Instant::now() + timeout;
    loop {
        match attempt() {
            Err(StoreFault::Locked) if Instant::now() < until => sleep(BUSY_RETRY_INTERVAL),
            ended => return ended,
        }
    }
}
