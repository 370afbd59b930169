//! `--capture` and `--replay`: the links between the program and its devices.

use std::path::{Path, PathBuf};

use super::failure::Failure;
use super::files::state_folder;
use crate::setup::Devices;
use link::{Capture, Replay, Wiring};

pub struct Wires<'a> {
    wiring: Wiring,
    captured: Option<&'a Path>,
    /// State directory of a replay; deleted at its end.
    scratch: Option<Scratch>,
}

impl<'a> Wires<'a> {
    pub fn of(captured: Option<&'a Path>, replayed: Option<&Path>) -> Result<Self, Failure> {
        let (wiring, scratch) = match (captured, replayed) {
            (Some(file), _) => (Wiring::Captured(capture(file)?), None),
            (None, Some(file)) => {
                let replay = Replay::read(file).map_err(|error| {
                    Failure::new(error, "give a file as `trued run --capture FILE` wrote it")
                })?;
                (Wiring::Replayed(replay), Some(Scratch::new()?))
            }
            (None, None) => (Wiring::Plain, None),
        };
        Ok(Self { wiring, captured, scratch })
    }

    /// Whether the journal outlives the program.
    pub fn keeps(&self) -> bool {
        self.scratch.is_none()
    }

    /// Directory of journal and locks. A replay measures nothing: it has a directory of its own, and it cannot
    /// be resumed.
    pub fn folder(&self, state: Option<&Path>) -> Result<PathBuf, Failure> {
        match &self.scratch {
            Some(scratch) => Ok(scratch.0.clone()),
            None => state_folder(state),
        }
    }

    /// Opens the devices over these links.
    pub async fn connect(
        &self,
        opening: impl Future<Output = Result<Devices, Failure>>,
    ) -> Result<Devices, Failure> {
        let mut devices = self.wiring.clone().during(opening).await?;
        if let Wiring::Replayed(replay) = &self.wiring {
            devices.clock = replay.clock();
        }
        Ok(devices)
    }

    /// Ends the capture after the run, also after an error, and reports whether it is complete.
    ///
    /// # Errors
    /// The error of the run; in a replay with a message for replays.
    pub fn finish<T>(&self, ended: Result<T, Failure>) -> Result<T, Failure> {
        if let (Wiring::Captured(capture), Some(file)) = (&self.wiring, self.captured) {
            match capture.finish() {
                Ok(()) => tell!("captured to {}", file.display()),
                Err(error) => tell!("{}: the capture is not whole: {error}", file.display()),
            }
        }
        ended.map_err(|failure| if self.keeps() { failure } else { of_replay(failure) })
    }
}

/// The error of a replay: nothing has moved, and the run cannot be resumed.
fn of_replay(failure: Failure) -> Failure {
    Failure::new(
        format!("the replay ended: {}", failure.what),
        "a capture replays only the run that it was made of, to where that run ended: the same machine \
         file, method and version",
    )
}

fn capture(file: &Path) -> Result<Capture, Failure> {
    Capture::create(file).map_err(|error| match error.kind() {
        std::io::ErrorKind::AlreadyExists => Failure::new(
            format!("{} is there already", file.display()),
            "a capture is never overwritten: give another name, or move it away",
        ),
        _ => Failure::file(file, &error),
    })
}

struct Scratch(PathBuf);

impl Scratch {
    fn new() -> Result<Self, Failure> {
        let folder = std::env::temp_dir().join(format!("trued-replay-{}", std::process::id()));
        std::fs::create_dir_all(&folder).map_err(|error| Failure::file(&folder, &error))?;
        Ok(Self(folder))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // A leftover directory does no harm.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
