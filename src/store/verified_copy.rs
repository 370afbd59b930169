//! A copy of an open journal as one file.

use std::fs;
use std::path::{Path, PathBuf};

use rusqlite::Connection;
use rusqlite::backup::{Backup, StepResult};

use super::{StoreFault, durable_dir};

/// Copies the journal to `file`, which must not exist. The copy gets this name only after it is complete, accepted by
/// `verify` and on the disk. Returns the result of `verify`.
pub(super) fn copy_verified<T>(
    source: &Connection,
    file: &Path,
    verify: impl FnOnce(&Connection) -> Result<T, StoreFault>,
) -> Result<T, StoreFault> {
    if file.exists() {
        return Err(StoreFault::FileExists);
    }
    let part = partial_copy_path(file);
    let kept = copy_pages_and_check_integrity(source, &part).and_then(|copy| {
        let verified_result = verify(&copy)?;
        drop(copy);
        fs::rename(&part, file)?;
        Ok(verified_result)
    });
    if kept.is_err() {
        let _ = fs::remove_file(&part);
    }
    let verified_result = kept?;
    let parent = file.parent().filter(|parent| !parent.as_os_str().is_empty());
    durable_dir::sync_dir(parent.unwrap_or(Path::new(".")))?;
    Ok(verified_result)
}

/// Name of the copy until it is complete: that of `file` with `.part` at the end.
fn partial_copy_path(file: &Path) -> PathBuf {
    let mut name = file.file_name().unwrap_or_default().to_owned();
    name.push(".part");
    file.with_file_name(name)
}

/// Copies all pages to `part`, checks the integrity of the copy and returns it open.
fn copy_pages_and_check_integrity(source: &Connection, part: &Path) -> Result<Connection, StoreFault> {
    // A copy that was not completed may have left this file.
    durable_dir::remove_file_if_exists(part)?;
    let mut copy = Connection::open(part)?;
    // All pages in one step: with a write-ahead log no writer waits for a reader.
    match Backup::new(source, &mut copy)?.step(-1)? {
        StepResult::Done => {}
        _ => return Err(StoreFault::Locked),
    }
    // The copy is one file, without a write-ahead log beside it.
    copy.pragma_update_and_check(None, "journal_mode", "DELETE", |_| Ok(()))?;
    let report: String = copy.pragma_query_value(None, "integrity_check", |row| row.get(0))?;
    match report.as_str() {
        "ok" => Ok(copy),
        _ => Err(StoreFault::Damaged(report)),
    }
}
