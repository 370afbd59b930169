//! Ensures one owner of a machine across processes by a locked file per machine. The operating system releases
//! the lock whenever the process ends.

use std::fs::{self, File, TryLockError};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::{durable_dir, sha256_text};

/// Process that holds the lock of a machine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LockHolder {
    pub machine: String,
    pub pid: u32,
    /// Time at which the process locked the machine.
    pub since: Timestamp,
}

/// Why a machine cannot be locked.
#[derive(Debug, thiserror::Error)]
pub enum LockError {
    #[error("machine `{machine}` is in use{}", holder_text(holder.as_ref()))]
    MachineInUse {
        machine: String,
        /// `None` in the moment before the other process has written its data.
        holder: Option<LockHolder>,
    },
    #[error("the lock file {path} of the machine cannot be opened or locked: {source}", path = path.display())]
    LockFileUnavailable { path: PathBuf, source: io::Error },
}

fn holder_text(holder: Option<&LockHolder>) -> String {
    holder.map(|who| format!(" by process {} since {}", who.pid, who.since)).unwrap_or_default()
}

impl LockError {
    /// Remedy to show to the user.
    pub fn remedy(&self) -> &'static str {
        match self {
            LockError::MachineInUse { .. } => "wait for that run to end, or stop it, then start again",
            LockError::LockFileUnavailable { source, .. } => match source.kind() {
                ErrorKind::StorageFull => "free space on the disk of the lock file, then start again",
                ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => {
                    "grant this user write permission, or choose another directory with --state"
                }
                _ => "check the disk, or choose another directory with --state",
            },
        }
    }
}

/// Lock of a machine, held as long as this value lives.
#[derive(Debug)]
pub struct MachineLock {
    file: File,
    machine: String,
}

impl MachineLock {
    /// Locks the machine named `machine` for this process without waiting.
    ///
    /// # Errors
    /// [`LockError::MachineInUse`] with the holder, or [`LockError::LockFileUnavailable`].
    pub fn acquire(state_dir: &Path, machine: &str) -> Result<Self, LockError> {
        let path = state_dir.join("locks").join(lock_file_name(machine));
        let unavailable = |source| LockError::LockFileUnavailable { path: path.clone(), source };
        let file = open_lock_file(&path).map_err(unavailable)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let content = fs::read(&path).map_err(unavailable)?;
                let holder = serde_json::from_slice(&content).ok();
                return Err(LockError::MachineInUse { machine: machine.to_owned(), holder });
            }
            Err(TryLockError::Error(source)) => return Err(unavailable(source)),
        }
        let lock = Self { file, machine: machine.to_owned() };
        lock.write_holder().map_err(unavailable)?;
        Ok(lock)
    }

    /// Holder of the machine named `machine`; `None`: there is none, or the lock file cannot be read. The check does
    /// not disturb a process that acquires the lock, except for an instant after a holder was killed.
    pub fn holder(state_dir: &Path, machine: &str) -> Option<LockHolder> {
        let path = state_dir.join("locks").join(lock_file_name(machine));
        let holder = serde_json::from_slice(&fs::read(&path).ok()?).ok()?;
        let file = open_lock_file(&path).ok()?;
        matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)).then_some(holder)
    }

    /// Name of the locked machine.
    pub fn machine(&self) -> &str {
        &self.machine
    }

    /// Replaces the content of the lock file by the data of this process.
    fn write_holder(&self) -> io::Result<()> {
        let machine = self.machine.clone();
        let holder = LockHolder { machine, pid: std::process::id(), since: Timestamp::now() };
        self.file.set_len(0)?;
        (&self.file).write_all(&serde_json::to_vec(&holder)?)
    }
}

impl Drop for MachineLock {
    fn drop(&mut self) {
        // Removes the holder's data, so that a later holder is not mistaken for this one; closing the file
        // releases the lock.
        let _ = self.file.set_len(0);
    }
}

fn open_lock_file(path: &Path) -> io::Result<File> {
    if let Some(parent) = path.parent() {
        durable_dir::create_dir_durably(parent)?;
    }
    File::options().read(true).write(true).create(true).truncate(false).open(path)
}

/// File name of a lock: readable, valid for any name of a machine, and unique to the name.
fn lock_file_name(machine: &str) -> String {
    let readable: String = machine.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).take(40).collect();
    let digest: String = sha256_text(machine).chars().take(16).collect();
    format!("{readable}-{digest}.lock")
}
