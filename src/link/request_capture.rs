//! Capture of devices that do not use a byte stream: the driver records requests and replies as lines of text.

use super::LinkError;
use super::capture::LinkProtocol;
use super::mode::{LinkBackend, LinkMode};

/// Recorder of one device, or the replay that answers in its place.
pub struct SensorRequestCapture {
    name: String,
    backend: LinkBackend,
}

impl SensorRequestCapture {
    /// No capture.
    pub fn disabled() -> Self {
        Self { name: String::new(), backend: LinkBackend::Direct }
    }

    /// Connects the device to `mode`; `name` is the name of the device in the capture.
    pub fn from_mode(mode: &LinkMode, name: &str) -> Self {
        let backend = mode.for_link(name, LinkProtocol::Samples);
        backend.record_opening();
        Self { name: name.to_owned(), backend }
    }

    /// Whether a capture answers, so that no device is opened.
    pub fn is_replayed(&self) -> bool {
        self.backend.is_replayed()
    }

    /// Records a line of a request.
    pub fn record_request(&self, line: &str) {
        self.backend.record('>', format!("{line}\n").as_bytes());
    }

    /// Records a line of a reply.
    pub fn record_reply(&self, line: &str) {
        self.backend.record('<', format!("{line}\n").as_bytes());
    }

    /// The captured reply lines; empty if nothing is replayed.
    ///
    /// # Errors
    /// The line does not match the capture.
    pub fn replay_request(&self, line: &str) -> Result<Vec<String>, LinkError> {
        let LinkBackend::Replayed(replay) = &self.backend else { return Ok(Vec::new()) };
        let reply = replay
            .exchange(format!("{line}\n").as_bytes())
            .map_err(|error| LinkError::Lost { address: self.name.clone(), why: error.to_string() })?;
        Ok(String::from_utf8_lossy(&reply).lines().map(str::to_owned).collect())
    }
}
