//! A copy of the journal, taken while it is written: one file, whole as of one instant, looked through
//! before it gets its name.

use std::path::Path;

use rusqlite::Connection;

use super::folder::JOURNAL;
use super::{Fault, RunId, StoreError, read, schema, snapshot};

/// Copy the journal in `dir` to `file`, which must not be there yet; whoever writes goes on writing.
/// Answers with the newest run that is in it.
///
/// # Errors
/// There is no journal, or no room; `file` exists; the copy is not sound.
pub fn backup(dir: &Path, file: &Path) -> Result<Option<RunId>, StoreError> {
    let journal = dir.join(JOURNAL);
    if !journal.is_file() {
        return Err(StoreError::at(&journal)(Fault::Missing));
    }
    let source = schema::open_reader(&journal).map_err(StoreError::at(&journal))?;
    copy(&source, file).map_err(StoreError::at(file))
}

fn copy(source: &Connection, file: &Path) -> Result<Option<RunId>, Fault> {
    snapshot::keep(source, file)?;
    let runs = read::runs(&schema::open_reader(file)?)?;
    Ok(runs.last().map(|run| run.id))
}
