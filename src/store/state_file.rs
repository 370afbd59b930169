//! Small JSON files in the folder of the journal, which commands write and a running daemon reads.
//!
//! A file is replaced as a whole or not at all, under a lock. It belongs to the daemon's user, whichever user writes
//! it, and only this user can read it.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt, fchown};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::durable_dir::remove_file_if_exists;

/// Why a file of the state directory cannot be read, locked or replaced.
#[derive(Debug, thiserror::Error)]
pub enum StateFileError {
    #[error("{path}: {source}", path = path.display())]
    FileAccess { path: PathBuf, source: io::Error },
    #[error("{path}: {source}", path = path.display())]
    InvalidJson { path: PathBuf, source: serde_json::Error },
    #[error("{path} must belong to user {user}, but its owner cannot be changed", path = path.display())]
    OwnerChangeFailed { path: PathBuf, user: u32 },
}

impl StateFileError {
    /// Remedy for the user.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::FileAccess { source, .. } if source.kind() == ErrorKind::PermissionDenied => {
                "run the command as the daemon's user (`sudo -u trued trued ...`), and make that user the owner of \
                 the files there (`chown trued`)"
            }
            Self::OwnerChangeFailed { .. } => {
                "run the command as the daemon's user: `sudo -u trued trued ... --state /var/lib/trued`"
            }
            Self::FileAccess { .. } => {
                "check the disk and the owner of the folder, or choose another folder with --state"
            }
            Self::InvalidJson { .. } => "move the file away, then enter its content again",
        }
    }
}

/// Metadata by which a changed file is detected: inode, length in bytes, modification time in s and ns.
pub type FileVersion = (u64, u64, i64, i64);

/// A JSON file in the state directory.
pub struct StateFile {
    path: PathBuf,
}

impl StateFile {
    pub fn new(state_dir: &Path, file_name: &str) -> Self {
        Self { path: state_dir.join(file_name) }
    }

    /// Version of the file; `None` without a file.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn version(&self) -> Result<Option<FileVersion>, StateFileError> {
        match fs::metadata(&self.path) {
            Ok(meta) => Ok(Some((meta.ino(), meta.len(), meta.mtime(), meta.mtime_nsec()))),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            Err(source) => Err(self.file_error(source)),
        }
    }

    /// Content of the file; `None` without a file.
    ///
    /// # Errors
    /// The file exists and cannot be read, or is not a file of this kind.
    pub fn read<T: DeserializeOwned>(&self) -> Result<Option<T>, StateFileError> {
        match fs::read(&self.path) {
            Ok(bytes) => serde_json::from_slice(&bytes).map(Some).map_err(|error| self.json_error(error)),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            Err(source) => Err(self.file_error(source)),
        }
    }

    /// Waits until no other process holds the lock, then locks the file against changes by other processes until the
    /// returned file is dropped. Creates the folder.
    ///
    /// # Errors
    /// The lock file cannot be created, opened, locked or given to the daemon's user.
    pub fn lock(&self) -> Result<File, StateFileError> {
        fs::create_dir_all(self.folder()).map_err(|error| self.file_error(error))?;
        let path = self.path.with_extension("lock");
        let file = match create_private_file(&path) {
            Ok(made) => self.give_to_daemon_user(made, &path)?,
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                File::options().write(true).open(&path).map_err(|error| self.file_error(error))?
            }
            Err(error) => return Err(self.file_error(error)),
        };
        file.lock().map_err(|error| self.file_error(error))?;
        Ok(file)
    }

    /// Replaces the file; on return, `content` is on the disk. Call this function under [`Self::lock`].
    ///
    /// # Errors
    /// The file cannot be written or given to the daemon's user; its previous content is unchanged, unless only the
    /// last sync of the folder failed.
    pub fn replace(&self, content: &impl Serialize) -> Result<(), StateFileError> {
        let text = serde_json::to_string_pretty(content).map_err(|error| self.json_error(error))?;
        let (temporary_path, failed) = (self.path.with_extension("new"), |error| self.file_error(error));
        // A process that died may have left this file.
        remove_file_if_exists(&temporary_path).map_err(failed)?;
        let mut file =
            self.give_to_daemon_user(create_private_file(&temporary_path).map_err(failed)?, &temporary_path)?;
        file.write_all(text.as_bytes()).and_then(|()| file.sync_all()).map_err(failed)?;
        fs::rename(&temporary_path, &self.path).map_err(failed)?;
        File::open(self.folder()).and_then(|folder| folder.sync_all()).map_err(failed)
    }

    fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new("."))
    }

    /// Gives the new `file` at `path` to the daemon's user, because the daemon could not read another user's file.
    /// The daemon's user is the owner of the existing file or, without one or if root owns it, of the folder.
    fn give_to_daemon_user(&self, file: File, path: &Path) -> Result<File, StateFileError> {
        let failed = |error| self.file_error(error);
        let own = file.metadata().map_err(failed)?.uid();
        // A file that belongs to root does not show which user the daemon runs as.
        let existing = fs::metadata(&self.path).ok().filter(|existing| existing.uid() != 0);
        let owner = existing.map_or_else(|| fs::metadata(self.folder()), Ok).map_err(failed)?;
        let user = owner.uid();
        if own != user && fchown(&file, Some(user), Some(owner.gid())).is_err() {
            let _ = fs::remove_file(path);
            return Err(StateFileError::OwnerChangeFailed { path: path.to_owned(), user });
        }
        Ok(file)
    }

    fn file_error(&self, source: io::Error) -> StateFileError {
        StateFileError::FileAccess { path: self.path.clone(), source }
    }

    fn json_error(&self, source: serde_json::Error) -> StateFileError {
        StateFileError::InvalidJson { path: self.path.clone(), source }
    }
}

/// Creates a new file that only this user can access; fails if the file exists, also as a symbolic link.
fn create_private_file(path: &Path) -> io::Result<File> {
    File::options().write(true).create_new(true).mode(0o600).open(path)
}
