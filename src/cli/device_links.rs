//! `--capture` and `--replay`: the links between the program and its devices.

use std::path::{Path, PathBuf};

use super::failure::CommandFailure;
use super::files::state_folder;
use crate::setup::Devices;
use link::{CaptureReplay, CaptureWriter, LinkMode};

/// How the links of one command to its devices are opened: directly, with a capture, or from a replayed capture.
pub struct DeviceLinks<'a> {
    link_mode: LinkMode,
    capture_file: Option<&'a Path>,
    /// State directory of a replay; deleted at its end.
    replay_folder: Option<TemporaryFolder>,
}

impl<'a> DeviceLinks<'a> {
    /// Creates the capture file, which must not exist yet, or reads the capture in `replayed`.
    pub fn from_options(capture_file: Option<&'a Path>, replayed: Option<&Path>) -> Result<Self, CommandFailure> {
        let (wiring, replay_folder) = match (capture_file, replayed) {
            (Some(file), _) => {
                let capture = CaptureWriter::create(file)
                    .map_err(|error| CommandFailure::from_new_file_error(file, &error, "capture"))?;
                (LinkMode::Captured(capture), None)
            }
            (None, Some(file)) => {
                let replay = CaptureReplay::read(file).map_err(|error| {
                    CommandFailure::new(error, "use a file that `trued run --capture FILE` has written")
                })?;
                (LinkMode::Replayed(replay), Some(TemporaryFolder::new()?))
            }
            (None, None) => (LinkMode::Direct, None),
        };
        Ok(Self { link_mode: wiring, capture_file, replay_folder })
    }

    /// Whether the journal is kept after the program ends; that of a replay is deleted.
    pub fn is_journal_kept(&self) -> bool {
        self.replay_folder.is_none()
    }

    /// Directory of journal and locks. A replay measures nothing: it has a directory of its own, and it cannot
    /// be resumed.
    pub fn state_folder(&self, state: Option<&Path>) -> Result<PathBuf, CommandFailure> {
        match &self.replay_folder {
            Some(replay_folder) => Ok(replay_folder.0.clone()),
            None => state_folder(state),
        }
    }

    /// Opens the devices over these links.
    pub async fn connect(
        &self,
        opening: impl Future<Output = Result<Devices, CommandFailure>>,
    ) -> Result<Devices, CommandFailure> {
        let mut devices = self.link_mode.clone().apply_to(opening).await?;
        if let LinkMode::Replayed(replay) = &self.link_mode {
            devices.clock = replay.clock();
        }
        Ok(devices)
    }

    /// Ends the capture after the run, also after an error, and prints whether the capture is complete.
    ///
    /// # Errors
    /// The error of the run; in a replay with a message for replays.
    pub fn end_capture_and_map_error<T>(&self, ended: Result<T, CommandFailure>) -> Result<T, CommandFailure> {
        if let (LinkMode::Captured(capture), Some(file)) = (&self.link_mode, self.capture_file) {
            match capture.finish() {
                Ok(()) => errln!("capture written: {}", file.display()),
                Err(error) => errln!("{}: the capture is incomplete: {error}", file.display()),
            }
        }
        ended.map_err(|failure| if self.is_journal_kept() { failure } else { replay_failure(failure) })
    }
}

/// The error of a replay: nothing has moved, and the run cannot be resumed.
fn replay_failure(failure: CommandFailure) -> CommandFailure {
    CommandFailure::new(
        format!("the replay ended: {}", failure.message),
        "use the machine file, the method and the program version of the captured run; a replay cannot \
        continue after the end of that run",
    )
}

/// Directory that is deleted on drop.
struct TemporaryFolder(PathBuf);

impl TemporaryFolder {
    fn new() -> Result<Self, CommandFailure> {
        let folder = std::env::temp_dir().join(format!("trued-replay-{}", std::process::id()));
        std::fs::create_dir_all(&folder).map_err(|error| CommandFailure::from_file_error(&folder, &error))?;
        Ok(Self(folder))
    }
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        // A leftover directory does no harm.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
