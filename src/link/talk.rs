//! Capture of devices that do not use a byte stream: the driver records requests and replies as lines of text.

use super::LinkError;
use super::capture::LinkProtocol;
use super::wiring::{Wired, Wiring};

/// Recorder of one device, or the replay that answers in its place.
pub struct Talk {
    name: String,
    wired: Wired,
}

impl Talk {
    /// No capture.
    pub fn plain() -> Self {
        Self { name: String::new(), wired: Wired::Plain }
    }

    /// Connects the device to `wiring`; `name` is the name of the device in the capture.
    pub fn over(wiring: &Wiring, name: &str) -> Self {
        let wired = wiring.of(name, LinkProtocol::Samples);
        if let Wired::RecordedStream(tap) = &wired {
            tap.opened();
        }
        Self { name: name.to_owned(), wired }
    }

    /// Whether a capture answers, so that no device is opened.
    pub fn is_replayed(&self) -> bool {
        matches!(self.wired, Wired::Played(_))
    }

    /// Records a line of a request.
    pub fn asked(&self, line: &str) {
        self.note('>', line);
    }

    /// Records a line of a reply.
    pub fn said(&self, line: &str) {
        self.note('<', line);
    }

    fn note(&self, mark: char, line: &str) {
        if let Wired::RecordedStream(tap) = &self.wired {
            tap.note(mark, format!("{line}\n").as_bytes());
        }
    }

    /// The captured reply lines; empty if nothing is replayed.
    ///
    /// # Errors
    /// The line does not match the capture.
    pub fn replayed(&self, line: &str) -> Result<Vec<String>, LinkError> {
        let Wired::Played(player) = &self.wired else { return Ok(Vec::new()) };
        let said = player.ask(format!("{line}\n").as_bytes()).map_err(|error| LinkError::Lost {
            address: self.name.clone(),
            why: error.to_string(),
        })?;
        Ok(String::from_utf8_lossy(&said).lines().map(str::to_owned).collect())
    }
}
