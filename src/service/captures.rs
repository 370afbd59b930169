//! `--capture` of the service: one capture file for each run.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::Log;
use crate::store::RunId;
use link::{Capture, Wiring};

/// Names of the capture files: `talk.capture` becomes `talk-17.capture` for run 17. Until the run has its number
/// the file is `talk-begun.capture`. If that file is left over from a cycle that never became a run, the next
/// name is `talk-begun-2.capture`.
#[derive(Clone)]
pub(super) struct Captures(PathBuf);

/// The capture of one cycle.
pub(super) struct Begun<'a> {
    captures: &'a Captures,
    file: PathBuf,
    capture: Capture,
    log: &'a Log,
}

impl Captures {
    pub(super) fn new(file: PathBuf) -> Self {
        Self(file)
    }

    /// Creates the capture file of a cycle; never overwrites a file. On failure, a fault is logged and the run
    /// continues without a capture.
    pub(super) fn begin<'a>(&'a self, log: &'a Log) -> Option<Begun<'a>> {
        let later = (2..).map(|number| self.named(&format!("begun-{number}")));
        for file in std::iter::once(self.named("begun")).chain(later) {
            match Capture::create(&file) {
                Ok(capture) => return Some(Begun { captures: self, file, capture, log }),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
                Err(error) => {
                    log.fault(&format!("{}: no capture: {error}", file.display()));
                    return None;
                }
            }
        }
        None
    }

    /// Removes the capture of `run`. Returns whether a file was removed.
    pub(super) fn forget(&self, run: RunId) -> bool {
        std::fs::remove_file(self.named(&run.to_string())).is_ok()
    }

    fn named(&self, what: &str) -> PathBuf {
        let Self(file) = self;
        let stem = file.file_stem().unwrap_or_default().to_string_lossy();
        let ending = file.extension().map(|ending| format!(".{}", ending.to_string_lossy()));
        file.with_file_name(format!("{stem}-{what}{}", ending.unwrap_or_default()))
    }
}

impl Begun<'_> {
    pub(super) fn wiring(&self) -> Wiring {
        Wiring::Captured(self.capture.clone())
    }

    /// Renames the capture after the run, which now has its number.
    pub(super) fn is_of(&self, run: RunId) {
        let (from, to) = (&self.file, self.captures.named(&run.to_string()));
        if let Err(error) = keep(from, &to) {
            self.log.fault(&format!(
                "{}: {error}: the capture stays {}",
                to.display(),
                from.display()
            ));
        }
    }

    /// Completes the capture after the run, whatever its outcome.
    pub(super) fn finish(self) {
        if let Err(error) = self.capture.finish() {
            self.log.fault(&format!("the capture is not whole: {error}"));
        }
    }
}

/// Renames `from` to `to`; never overwrites a file.
fn keep(from: &Path, to: &Path) -> std::io::Result<()> {
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
    fn what_a_cycle_left_is_kept_and_the_next_takes_another_name() {
        let folder = tempfile::tempdir().unwrap();
        let captures = Captures::new(folder.path().join("talk.capture"));
        let left = ["talk-begun.capture", "talk-begun-2.capture"];
        for name in left {
            std::fs::write(folder.path().join(name), name).unwrap();
        }
        let log: Log = Log::new(|_, line| panic!("{line}"));
        let begun = captures.begin(&log).unwrap();
        begun.is_of(RunId(17));
        begun.finish();
        let mut names: Vec<_> = std::fs::read_dir(folder.path())
            .unwrap()
            .map(|file| file.unwrap().file_name())
            .collect();
        names.sort();
        assert_eq!(names, ["talk-17.capture", left[1], left[0]]);
        for name in left {
            assert_eq!(std::fs::read_to_string(folder.path().join(name)).unwrap(), name);
        }
    }
}
