//! `--capture` of the service: a file for each run.

use std::path::{Path, PathBuf};

use super::Log;
use crate::link::{Capture, Wiring};
use crate::store::RunId;

/// Where they go: `talk.capture` becomes `talk-17.capture` for run 17. Until the run has its number the
/// file is `talk-begun.capture`; what stays under that name belongs to no run.
#[derive(Clone)]
pub(super) struct Captures(PathBuf);

/// The capture of one cycle.
pub(super) struct Begun<'a> {
    captures: &'a Captures,
    capture: Capture,
    log: &'a Log,
}

impl Captures {
    pub(super) fn new(file: PathBuf) -> Self {
        Self(file)
    }

    /// A run goes on without it.
    pub(super) fn begin<'a>(&'a self, log: &'a Log) -> Option<Begun<'a>> {
        let file = self.named("begun");
        // Of a cycle that never became a run.
        let _ = std::fs::remove_file(&file);
        match Capture::create(&file) {
            Ok(capture) => Some(Begun { captures: self, capture, log }),
            Err(error) => {
                log(&format!("{}: no capture: {error}", file.display()));
                None
            }
        }
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

    /// The run has its number.
    pub(super) fn is_of(&self, run: RunId) {
        let (from, to) = (self.captures.named("begun"), self.captures.named(&run.to_string()));
        if let Err(error) = keep(&from, &to) {
            (self.log)(&format!("{}: {error}: the capture stays {}", to.display(), from.display()));
        }
    }

    /// The run has ended, however.
    pub(super) fn finish(self) {
        if let Err(error) = self.capture.finish() {
            (self.log)(&format!("the capture is not whole: {error}"));
        }
    }
}

/// Nothing is overwritten.
fn keep(from: &Path, to: &Path) -> std::io::Result<()> {
    match std::fs::hard_link(from, to) {
        Ok(()) => std::fs::remove_file(from),
        Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => Err(error),
        // A file system without links, as on a stick.
        Err(_) => {
            drop(std::fs::File::create_new(to)?);
            std::fs::rename(from, to)
        }
    }
}
