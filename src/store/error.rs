//! Errors of the journal and their remedies.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use rusqlite::ErrorCode;
use rusqlite::ffi::{SQLITE_CONSTRAINT_FOREIGNKEY, SQLITE_CONSTRAINT_UNIQUE};

use super::RunId;

/// `errno` of a failing disk, the same on every Linux.
const EIO: i32 = 5;

/// A fault and the journal that it concerns. Acknowledged data stays.
#[derive(Debug, thiserror::Error)]
#[error("journal {}: {fault}", path.display())]
pub struct StoreError {
    pub path: PathBuf,
    #[source]
    pub fault: Fault,
}

#[derive(Debug, thiserror::Error)]
pub enum Fault {
    #[error("the disk is full")]
    Full,
    #[error("it may not be written")]
    ReadOnly,
    #[error("another program keeps it locked")]
    Busy,
    #[error("the disk reports an error: {0}")]
    Disk(String),
    #[error("it is damaged: {0}")]
    Damaged(String),
    #[error("it is not a journal of trued (application id {mark}, version {format})")]
    Foreign { mark: i32, format: i64 },
    #[error("it was written by a newer trued (format {found}; this one knows {known})")]
    Newer { found: i64, known: i64 },
    #[error("its disk cannot hold a write-ahead log (SQLite chose `{mode}`)")]
    NoLog { mode: String },
    #[error(transparent)]
    Io(io::Error),
    #[error("there is none")]
    Missing,
    #[error("it is there already")]
    Exists,
    #[error("there is no run {0}")]
    NoRun(RunId),
    #[error("{what} holds a number that is not finite and cannot be kept")]
    NotFinite { what: String },
    #[error("step {step} repeat {repeat} was measured already; a touch is kept once")]
    Doubled { step: u32, repeat: u32 },
    #[error("its writer has ended")]
    WriterGone,
    #[error("SQLite: {0}")]
    Sql(rusqlite::Error),
}

impl StoreError {
    pub(super) fn at(path: &Path) -> impl Fn(Fault) -> StoreError + '_ {
        move |fault| StoreError { path: path.to_owned(), fault }
    }

    /// Remedy to show to the user.
    pub fn remedy(&self) -> &'static str {
        match &self.fault {
            Fault::Full => {
                "make room on that disk, then resume the run: what was acknowledged is safe"
            }
            Fault::ReadOnly | Fault::Io(_) => {
                "give this user the right to write there, or choose another place with --state"
            }
            Fault::Busy => "close the other program that works on this journal, then start again",
            Fault::Disk(_) => "copy the journal to another disk and check this one",
            Fault::Damaged(_) => {
                "keep the file, and take the newest backup, or start a new journal, with --state; `sqlite3 FILE .recover` may save its rows"
            }
            Fault::Foreign { .. } => {
                "the file is left as it was: name the folder of the journal, or a new folder, with --state"
            }
            Fault::Newer { .. } => "use the newer trued, or another place with --state",
            Fault::NoLog { .. } => "put the journal on a local disk with --state",
            Fault::Missing => "the first run makes it; say with --state where it is",
            Fault::Exists => "nothing is overwritten: choose another name",
            Fault::NoRun(_) => "`trued runs` lists them",
            Fault::NotFinite { .. } | Fault::Doubled { .. } | Fault::WriterGone | Fault::Sql(_) => {
                "please report this with the run's export"
            }
        }
    }
}

impl Fault {
    /// Converts an error; a violated uniqueness constraint can only mean that this touch exists already.
    pub(super) fn of_reading(
        run: RunId,
        step: u32,
        repeat: u32,
    ) -> impl Fn(rusqlite::Error) -> Fault {
        move |error| match &error {
            rusqlite::Error::SqliteFailure(code, _)
                if code.extended_code == SQLITE_CONSTRAINT_UNIQUE =>
            {
                Fault::Doubled { step, repeat }
            }
            _ => Fault::of_run(run)(error),
        }
    }

    /// Converts an error; a violated foreign key can only mean that `run` does not exist.
    pub(super) fn of_run(run: RunId) -> impl Fn(rusqlite::Error) -> Fault {
        move |error| match &error {
            rusqlite::Error::SqliteFailure(code, _)
                if code.extended_code == SQLITE_CONSTRAINT_FOREIGNKEY =>
            {
                Fault::NoRun(run)
            }
            _ => error.into(),
        }
    }
}

impl From<io::Error> for Fault {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            ErrorKind::StorageFull => Fault::Full,
            // EIO has no `ErrorKind`.
            _ if error.raw_os_error() == Some(EIO) => Fault::Disk(error.to_string()),
            _ => Fault::Io(error),
        }
    }
}

impl From<rusqlite::Error> for Fault {
    fn from(error: rusqlite::Error) -> Self {
        match error.sqlite_error_code() {
            Some(ErrorCode::DiskFull) => Fault::Full,
            Some(ErrorCode::ReadOnly | ErrorCode::PermissionDenied | ErrorCode::CannotOpen) => {
                Fault::ReadOnly
            }
            Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => Fault::Busy,
            Some(ErrorCode::SystemIoFailure) => Fault::Disk(error.to_string()),
            Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase) => {
                Fault::Damaged(error.to_string())
            }
            _ => match error {
                rusqlite::Error::FromSqlConversionFailure(..)
                | rusqlite::Error::InvalidColumnType(..)
                | rusqlite::Error::IntegralValueOutOfRange(..) => Fault::Damaged(error.to_string()),
                other => Fault::Sql(other),
            },
        }
    }
}
