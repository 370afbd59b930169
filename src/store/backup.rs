//! A copy of the journal, taken while it is written: one file, whole as of one instant, verified before it gets its
//! name.

use std::path::Path;

use rusqlite::Connection;

use super::folder::JOURNAL;
use super::{Fault, RunId, StoreError, checksum, connection, identity, read, snapshot};

/// What a copy holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Copied {
    pub newest: Option<RunId>,
    /// Those of a journal that only older versions have opened have none: SQLite's own check of the file is all
    /// that was verified.
    pub has_checksums: bool,
}

/// Copy the journal in `dir` to `file`, which must not be there yet; whoever writes goes on writing.
///
/// # Errors
/// There is no journal, or no room; `file` exists; the journal is foreign or damaged.
pub fn backup(dir: &Path, file: &Path) -> Result<Copied, StoreError> {
    let journal = dir.join(JOURNAL);
    if !journal.is_file() {
        return Err(StoreError::at(&journal)(Fault::Missing));
    }
    let (source, format) = connection::open_source(&journal).map_err(StoreError::at(&journal))?;
    let has_checksums = format >= identity::FIRST_MARKED;
    let verified = |copy: &Connection| match has_checksums {
        true => {
            checksum::add_function(copy)?;
            checksum::verify_all(copy)?;
            Ok(read::runs(copy)?.last().map(|run| run.id))
        }
        false if format == 0 => Ok(None),
        false => Ok(copy
            .query_row("SELECT max(id) FROM runs", [], |row| row.get::<_, Option<i64>>(0))?
            .map(RunId)),
    };
    match snapshot::keep(&source, file, verified) {
        Ok(newest) => Ok(Copied { newest, has_checksums }),
        // The copy is removed: it was damaged before.
        Err(fault @ Fault::Damaged(_)) => Err(StoreError::at(&journal)(fault)),
        Err(fault) => Err(StoreError::at(file)(fault)),
    }
}
