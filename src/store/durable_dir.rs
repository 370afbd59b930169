//! Directories with durable names: after a power cut, a synced file is lost if the name of its directory is not
//! on the disk.

use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::Path;

/// File name of the journal in the state directory.
pub(super) const JOURNAL_FILE_NAME: &str = "journal.sqlite";

/// Creates `dir` and its missing parents.
pub(super) fn create_dir_durably(dir: &Path) -> io::Result<()> {
    let parent = dir.parent().filter(|parent| !parent.as_os_str().is_empty());
    let parent = parent.unwrap_or(Path::new("."));
    if !dir.is_dir() {
        if parent != Path::new(".") {
            create_dir_durably(parent)?;
        }
        match fs::create_dir(dir) {
            // Another process has created it.
            Err(error) if error.kind() == ErrorKind::AlreadyExists && dir.is_dir() => {}
            made => made?,
        }
    }
    match sync_dir(parent) {
        // The directory belongs to another user, and this process may not sync it.
        Err(error) if error.kind() == ErrorKind::PermissionDenied => Ok(()),
        synced => synced,
    }
}

/// Removes the file at `path`, if there is one.
pub(super) fn remove_file_if_exists(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        removed => removed,
    }
}

/// Syncs the names in `dir` to the disk.
pub(super) fn sync_dir(dir: &Path) -> io::Result<()> {
    File::open(dir)?.sync_all()
}
