//! Errors of the journal and their remedies.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use rusqlite::ErrorCode;
use rusqlite::ffi::{SQLITE_CONSTRAINT_FOREIGNKEY, SQLITE_CONSTRAINT_UNIQUE};

use super::RunId;

/// `errno` of a failing disk, the same on every Linux.
const EIO: i32 = 5;

/// A fault, and the path of its journal or of the copy in a backup. Acknowledged data is not lost.
#[derive(Debug, thiserror::Error)]
#[error("journal {}: {fault}", path.display())]
pub struct StoreError {
    pub path: PathBuf,
    #[source]
    pub fault: StoreFault,
}

/// Why the journal cannot be opened, read or written.
#[derive(Debug, thiserror::Error)]
pub enum StoreFault {
    #[error("the disk is full")]
    DiskFull,
    /// Also: the file cannot be opened, or its permissions forbid it.
    #[error("the file is not writable")]
    ReadOnly,
    #[error("another program has locked the file")]
    Locked,
    #[error("the disk reports an error: {0}")]
    DiskError(String),
    /// Also: a row with a wrong checksum, or a value that cannot be read.
    #[error("the file is damaged: {0}")]
    Damaged(String),
    /// `mark`: application ID in the header of the file.
    #[error("the file is not a journal of trued (application id {mark}, version {format})")]
    NotAJournal { mark: i32, format: i64 },
    #[error("a newer version of trued wrote the file (format {found}; this version supports formats up to {known})")]
    NewerFormat { found: i64, known: i64 },
    #[error("the file system does not support a write-ahead log (SQLite selected `{mode}`)")]
    NoWriteAheadLog { mode: String },
    #[error(transparent)]
    Io(io::Error),
    #[error("the file does not exist")]
    JournalMissing,
    /// The target of a copy exists.
    #[error("the file exists already")]
    FileExists,
    #[error("the journal has no run {0}")]
    RunNotFound(RunId),
    #[error("{what} contains a number that is not finite and cannot be stored")]
    NotFinite { what: String },
    #[error("step {step} repeat {repeat} has a stored reading already; each touch is stored once")]
    DuplicateTouch { step: u32, repeat: u32 },
    #[error("the writer thread of the journal has ended")]
    WriterEnded,
    #[error("SQLite: {0}")]
    Sql(rusqlite::Error),
}

impl StoreError {
    pub(super) fn from_fault_at(path: &Path) -> impl Fn(StoreFault) -> StoreError + '_ {
        move |fault| StoreError { path: path.to_owned(), fault }
    }

    /// Remedy to show to the user.
    pub fn remedy(&self) -> &'static str {
        match &self.fault {
            StoreFault::DiskFull => {
                "free space on the disk of the journal, then resume the run; acknowledged data is safe"
            }
            StoreFault::ReadOnly | StoreFault::Io(_) => {
                "grant this user write permission, or choose another directory with --state"
            }
            StoreFault::Locked => "close the other program that uses this journal, then start again",
            StoreFault::DiskError(_) => "copy the journal to another disk, and check the faulty disk",
            StoreFault::Damaged(_) => {
                "keep the damaged file; continue with the newest backup or a new journal in another directory with --state; `sqlite3 FILE .recover` may recover rows"
            }
            StoreFault::NotAJournal { .. } => {
                "set --state to the directory of the journal or to a new directory; the file was not changed"
            }
            StoreFault::NewerFormat { .. } => {
                "use the newer version of trued, or choose another directory with --state"
            }
            StoreFault::NoWriteAheadLog { .. } => "choose a directory on a local disk with --state",
            StoreFault::JournalMissing => {
                "set --state to the directory of the journal; the first run creates the journal"
            }
            StoreFault::FileExists => "choose another file name; existing files are not overwritten",
            StoreFault::RunNotFound(_) => "list the runs with `trued runs`",
            StoreFault::NotFinite { .. }
            | StoreFault::DuplicateTouch { .. }
            | StoreFault::WriterEnded
            | StoreFault::Sql(_) => "report this error with the run's export",
        }
    }
}

impl StoreFault {
    /// Converts an error; a violated uniqueness constraint can only mean that this touch exists already.
    pub(super) fn from_reading_error(run: RunId, step: u32, repeat: u32) -> impl Fn(rusqlite::Error) -> StoreFault {
        move |error| match &error {
            rusqlite::Error::SqliteFailure(code, _) if code.extended_code == SQLITE_CONSTRAINT_UNIQUE => {
                StoreFault::DuplicateTouch { step, repeat }
            }
            _ => StoreFault::from_run_error(run)(error),
        }
    }

    /// Converts an error; a violated foreign key can only mean that `run` does not exist.
    pub(super) fn from_run_error(run: RunId) -> impl Fn(rusqlite::Error) -> StoreFault {
        move |error| match &error {
            rusqlite::Error::SqliteFailure(code, _) if code.extended_code == SQLITE_CONSTRAINT_FOREIGNKEY => {
                StoreFault::RunNotFound(run)
            }
            _ => error.into(),
        }
    }
}

impl From<io::Error> for StoreFault {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            ErrorKind::StorageFull => StoreFault::DiskFull,
            // EIO has no `ErrorKind`.
            _ if error.raw_os_error() == Some(EIO) => StoreFault::DiskError(error.to_string()),
            _ => StoreFault::Io(error),
        }
    }
}

impl From<rusqlite::Error> for StoreFault {
    fn from(error: rusqlite::Error) -> Self {
        match error.sqlite_error_code() {
            Some(ErrorCode::DiskFull) => StoreFault::DiskFull,
            Some(ErrorCode::ReadOnly | ErrorCode::PermissionDenied | ErrorCode::CannotOpen) => StoreFault::ReadOnly,
            Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => StoreFault::Locked,
            Some(ErrorCode::SystemIoFailure) => StoreFault::DiskError(error.to_string()),
            Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase) => StoreFault::Damaged(error.to_string()),
            _ => match error {
                rusqlite::Error::FromSqlConversionFailure(..)
                | rusqlite::Error::InvalidColumnType(..)
                | rusqlite::Error::IntegralValueOutOfRange(..) => StoreFault::Damaged(error.to_string()),
                other => StoreFault::Sql(other),
            },
        }
    }
}
