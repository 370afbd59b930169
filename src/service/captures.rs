//! `--capture` of the service: one capture file for each run.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::Log;
use crate::store::RunId;
use link::{CaptureWriter, LinkMode};

/// Names of the capture files: `talk.capture` becomes `talk-17.capture` for run 17. Until the run has its number
/// the file is `talk-begun.capture`. If that file is left over from a cycle that never became a run, the next
/// name is `talk-begun-2.capture`.
#[derive(Clone)]
pub(super) struct CaptureFiles {
    /// Path as given by `--capture`; no file of exactly this name is created.
    configured_file: PathBuf,
}

/// The capture of one cycle.
pub(super) struct RunCapture<'a> {
    capture_files: &'a CaptureFiles,
    /// Path at creation, without the number of the run.
    file: PathBuf,
    capture: CaptureWriter,
    log: &'a Log,
}

impl CaptureFiles {
    pub(super) fn new(configured_file: PathBuf) -> Self {
        Self { configured_file }
    }

    /// Creates the capture file of a cycle; never overwrites a file. On failure, a fault is logged and the run
    /// continues without a capture.
    pub(super) fn create_for_cycle<'a>(&'a self, log: &'a Log) -> Option<RunCapture<'a>> {
        let numbered_paths = (2..).map(|number| self.path_for(&format!("begun-{number}")));
        for file in std::iter::once(self.path_for("begun")).chain(numbered_paths) {
            match CaptureWriter::create(&file) {
                Ok(capture) => return Some(RunCapture { capture_files: self, file, capture, log }),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
                Err(error) => {
                    log.error(&format!("{}: the capture file cannot be created: {error}", file.display()));
                    return None;
                }
            }
        }
        None
    }

    /// Removes the capture file of `run`. Returns whether a file was removed; `false` also after an error.
    pub(super) fn delete_capture_file(&self, run: RunId) -> bool {
        std::fs::remove_file(self.path_for(&run.to_string())).is_ok()
    }

    /// Path with `-label` before the file extension, in the folder of `configured_file`.
    fn path_for(&self, label: &str) -> PathBuf {
        let file = &self.configured_file;
        let stem = file.file_stem().unwrap_or_default().to_string_lossy();
        let extension = file.extension().map(|extension| format!(".{}", extension.to_string_lossy()));
        file.with_file_name(format!("{stem}-{label}{}", extension.unwrap_or_default()))
    }
}

impl RunCapture<'_> {
    pub(super) fn link_mode(&self) -> LinkMode {
        LinkMode::Captured(self.capture.clone())
    }

    /// Renames the capture file to the number of the run, which is known now.
    pub(super) fn name_after_run(&self, run: RunId) {
        let (from, to) = (&self.file, self.capture_files.path_for(&run.to_string()));
        if let Err(error) = rename_without_overwrite(from, &to) {
            self.log.error(&format!(
                "{}: the capture file cannot be renamed: {error}; the file keeps the name {}",
                to.display(),
                from.display()
            ));
        }
    }

    /// Completes the capture file after the run, also after a failed run.
    pub(super) fn finish(self) {
        if let Err(error) = self.capture.finish() {
            self.log.error(&format!("the capture file is incomplete: {error}"));
        }
    }
}

/// Renames `from` to `to`; never overwrites a file.
fn rename_without_overwrite(from: &Path, to: &Path) -> std::io::Result<()> {
    match std::fs::hard_link(from, to) {
        Ok(()) => std::fs::remove_file(from),
        Err(error) if error.kind() == ErrorKind::AlreadyExists => Err(error),
        // The file system has no hard links, for example on a USB stick.
        Err(_) => {
            drop(std::fs::File::create_new(to)?);
            std::fs::rename(from, to)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn existing_capture_is_kept_and_the_next_has_another_name() {
        let folder = tempfile::tempdir().unwrap();
        let captures = CaptureFiles::new(folder.path().join("talk.capture"));
        let left = ["talk-begun.capture", "talk-begun-2.capture"];
        for name in left {
            std::fs::write(folder.path().join(name), name).unwrap();
        }
        let log: Log = Log::new(|_, line| panic!("{line}"));
        let begun = captures.create_for_cycle(&log).unwrap();
        begun.name_after_run(RunId(17));
        begun.finish();
        let mut names: Vec<_> =
            std::fs::read_dir(folder.path()).unwrap().map(|file| file.unwrap().file_name()).collect();
        names.sort();
        assert_eq!(names, ["talk-17.capture", left[1], left[0]]);
        for name in left {
            assert_eq!(std::fs::read_to_string(folder.path().join(name)).unwrap(), name);
        }
    }
}
