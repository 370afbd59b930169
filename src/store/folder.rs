//! Folders whose names are on the disk: a file that is synced is lost all the same if the folder it
//! stands in has no name after a cut of the power.

use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::Path;

/// The journal's file in the state directory.
pub(super) const JOURNAL: &str = "journal.sqlite";

/// Make `dir` and its parents, as far as they are missing.
pub(super) fn make(dir: &Path) -> io::Result<()> {
    let parent = dir.parent().filter(|parent| !parent.as_os_str().is_empty());
    let parent = parent.unwrap_or(Path::new("."));
    if !dir.is_dir() {
        if parent != Path::new(".") {
            make(parent)?;
        }
        match fs::create_dir(dir) {
            // Another process was faster.
            Err(error) if error.kind() == ErrorKind::AlreadyExists && dir.is_dir() => {}
            made => made?,
        }
    }
    match sync(parent) {
        // Not ours, and neither are the names in it.
        Err(error) if error.kind() == ErrorKind::PermissionDenied => Ok(()),
        synced => synced,
    }
}

/// Put the names in `dir` on the disk.
pub(super) fn sync(dir: &Path) -> io::Result<()> {
    File::open(dir)?.sync_all()
}
