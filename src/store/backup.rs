//! A copy of the journal, taken while it is written: one file, whole as of one instant, looked through
//! before it gets its name.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use jiff::Timestamp;
use rusqlite::Connection;
use rusqlite::backup::{Backup, StepResult};

use super::journal::FILE;
use super::{Fault, RunId, StoreError, folder, read, schema};

/// Copy the journal in `dir` to `file`, which must not be there yet; whoever writes goes on writing.
/// Answers with the newest run that is in it.
///
/// # Errors
/// There is no journal, or no room; `file` exists; the copy is not sound.
pub fn backup(dir: &Path, file: &Path) -> Result<Option<RunId>, StoreError> {
    let journal = dir.join(FILE);
    if !journal.is_file() {
        return Err(StoreError::at(&journal)(Fault::Missing));
    }
    let source = schema::open_reader(&journal).map_err(StoreError::at(&journal))?;
    copy(&source, file).map_err(StoreError::at(file))
}

/// The journal at `path` as it is before it is brought up from version `found`, kept beside it.
pub(super) fn before_migration(path: &Path, found: i64) -> Result<(), Fault> {
    let now = Timestamp::now().strftime("%Y%m%dT%H%M%SZ");
    let kept = path.with_file_name(format!("journal-v{found}-{now}.sqlite"));
    keep(&schema::open_reader(path)?, &kept)
}

fn copy(source: &Connection, file: &Path) -> Result<Option<RunId>, Fault> {
    keep(source, file)?;
    let runs = read::runs(&schema::open_reader(file)?)?;
    Ok(runs.last().map(|run| run.id))
}

/// Under its name only once it is whole and on the disk.
fn keep(source: &Connection, file: &Path) -> Result<(), Fault> {
    if file.exists() {
        return Err(Fault::Exists);
    }
    let part = part(file);
    let kept = fill(source, &part).and_then(|()| Ok(fs::rename(&part, file)?));
    if let Err(fault) = kept {
        let _ = fs::remove_file(&part);
        return Err(fault);
    }
    let parent = file.parent().filter(|parent| !parent.as_os_str().is_empty());
    Ok(folder::sync(parent.unwrap_or(Path::new(".")))?)
}

fn part(file: &Path) -> PathBuf {
    let mut name = file.file_name().unwrap_or_default().to_owned();
    name.push(".part");
    file.with_file_name(name)
}

fn fill(source: &Connection, part: &Path) -> Result<(), Fault> {
    // Of a copy that did not come to its end.
    match fs::remove_file(part) {
        Err(error) if error.kind() != ErrorKind::NotFound => return Err(error.into()),
        _ => {}
    }
    let mut copy = Connection::open(part)?;
    // All pages in one look: with a write-ahead log no writer waits for a reader.
    match Backup::new(source, &mut copy)?.step(-1)? {
        StepResult::Done => {}
        _ => return Err(Fault::Busy),
    }
    // One file, with no log beside it.
    copy.pragma_update_and_check(None, "journal_mode", "DELETE", |_| Ok(()))?;
    let said: String = copy.pragma_query_value(None, "integrity_check", |row| row.get(0))?;
    match said.as_str() {
        "ok" => Ok(()),
        _ => Err(Fault::Damaged(said)),
    }
}
