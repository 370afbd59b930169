//! What a device is asked and what it says, told in lines by whoever speaks with it: for a capture of
//! what is no stream of bytes.

use super::LinkError;
use super::capture::Speech;
use super::wiring::{Wired, Wiring};

/// One device's place in a capture, or in a capture that answers instead of it.
pub struct Talk {
    name: String,
    wired: Wired,
}

impl Talk {
    /// Nobody listens.
    pub fn plain() -> Self {
        Self { name: String::new(), wired: Wired::Plain }
    }

    /// Behind `wiring`; `name` is how the device is called.
    pub fn over(wiring: &Wiring, name: &str) -> Self {
        let wired = wiring.of(name, Speech::Samples);
        if let Wired::Tapped(tap) = &wired {
            tap.opened();
        }
        Self { name: name.to_owned(), wired }
    }

    /// Nothing is opened: a capture answers.
    pub fn is_replayed(&self) -> bool {
        matches!(self.wired, Wired::Played(_))
    }

    /// A line that asks for something.
    pub fn asked(&self, line: &str) {
        self.note('>', line);
    }

    /// A line of the answer.
    pub fn said(&self, line: &str) {
        self.note('<', line);
    }

    fn note(&self, mark: char, line: &str) {
        if let Wired::Tapped(tap) = &self.wired {
            tap.note(mark, format!("{line}\n").as_bytes());
        }
    }

    /// The lines that were said then; none where nothing is replayed.
    ///
    /// # Errors
    /// The capture does not know this line here.
    pub fn replayed(&self, line: &str) -> Result<Vec<String>, LinkError> {
        let Wired::Played(player) = &self.wired else { return Ok(Vec::new()) };
        let said = player.ask(format!("{line}\n").as_bytes()).map_err(|error| LinkError::Lost {
            address: self.name.clone(),
            why: error.to_string(),
        })?;
        Ok(String::from_utf8_lossy(&said).lines().map(str::to_owned).collect())
    }
}
