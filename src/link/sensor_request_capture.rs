//! Capture of a sensor: the driver records each request that it receives, and its replies, as lines of text.

use super::LinkError;
use super::capture::LinkProtocol;
use super::link_mode::{LinkBackend, LinkMode};

/// Recorder of one sensor, or the replay of a capture instead of the sensor.
pub struct SensorRequestCapture {
    name: String,
    backend: LinkBackend,
}

impl SensorRequestCapture {
    /// Neither records nor replays the requests of the sensor.
    pub fn disabled() -> Self {
        Self { name: String::new(), backend: LinkBackend::Direct }
    }

    /// Records or replays, according to `mode`; `name` is the name of the sensor in the capture.
    pub fn from_mode(mode: &LinkMode, name: &str) -> Self {
        let backend = mode.backend_for_link(name, LinkProtocol::SensorSamples);
        backend.record_opening();
        Self { name: name.to_owned(), backend }
    }

    /// Whether a capture answers, so that no sensor is opened.
    pub fn is_replayed(&self) -> bool {
        self.backend.is_replayed()
    }

    /// Records one line of a request to the driver. The bytes on the wire are different.
    pub fn record_request(&self, line: &str) {
        self.backend.record_bytes('>', format!("{line}\n").as_bytes());
    }

    /// Records one line of the reply.
    pub fn record_reply(&self, line: &str) {
        self.backend.record_bytes('<', format!("{line}\n").as_bytes());
    }

    /// The captured reply lines to the request `line`; empty if nothing is replayed.
    ///
    /// # Errors
    /// The request does not match the capture.
    pub fn captured_replies_to(&self, line: &str) -> Result<Vec<String>, LinkError> {
        let LinkBackend::Replayed(replay) = &self.backend else { return Ok(Vec::new()) };
        let reply = replay
            .exchange(format!("{line}\n").as_bytes())
            .map_err(|error| LinkError::Lost { address: self.name.clone(), why: error.to_string() })?;
        Ok(String::from_utf8_lossy(&reply).lines().map(str::to_owned).collect())
    }
}
