//! Backup of the journal while it is in use: one consistent file, as of one instant, verified before it gets
//! its name.

use std::path::Path;

use rusqlite::Connection;

use super::durable_dir::JOURNAL_FILE_NAME;
use super::{RunId, StoreError, StoreFault, checksum, connection, format_identification, read, verified_copy};

/// Content of a backup: the newest run, and whether the rows of the journal have checksums.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BackupContent {
    /// `None`: the journal has no runs.
    pub newest_run: Option<RunId>,
    /// Whether the journal's rows have checksums. A journal that only older versions have opened has none; then
    /// only SQLite's integrity check was made.
    pub has_row_checksums: bool,
}

/// Copies the journal in `dir` to `file`, which must not exist. Writers are not blocked.
///
/// # Errors
/// There is no journal, the disk is full, `file` exists, or the journal is foreign or damaged.
pub fn backup(dir: &Path, file: &Path) -> Result<BackupContent, StoreError> {
    let journal = dir.join(JOURNAL_FILE_NAME);
    if !journal.is_file() {
        return Err(StoreError::from_fault_at(&journal)(StoreFault::JournalMissing));
    }
    let (source, format) = connection::open_backup_source(&journal).map_err(StoreError::from_fault_at(&journal))?;
    let has_checksums = format >= format_identification::FIRST_FORMAT_WITH_APPLICATION_ID;
    let verified = |copy: &Connection| match has_checksums {
        true => {
            checksum::add_checksum_function(copy)?;
            checksum::verify_all_rows(copy)?;
            Ok(read::select_all_runs(copy)?.last().map(|run| run.id))
        }
        false if format == 0 => Ok(None),
        false => Ok(copy.query_row("SELECT max(id) FROM runs", [], |row| row.get::<_, Option<i64>>(0))?.map(RunId)),
    };
    match verified_copy::copy_verified(&source, file, verified) {
        Ok(newest) => Ok(BackupContent { newest_run: newest, has_row_checksums: has_checksums }),
        // The damage was in the journal before the copy; the copy is removed.
        Err(fault @ StoreFault::Damaged(_)) => Err(StoreError::from_fault_at(&journal)(fault)),
        Err(fault) => Err(StoreError::from_fault_at(file)(fault)),
    }
}
