//! How a control is built, as `$I` tells it.

use super::driver::Grbl;
use super::message::Message;
use crate::controllers::ControllerError;
use machine::Axis;

/// How the control is built.
pub(super) struct Built {
    /// Grbl for three axes, before grblHAL.
    pub classic: bool,
    pub version: String,
    /// Its axis words in the order of its reports.
    pub letters: String,
}

impl Built {
    pub fn identity(&self) -> String {
        format!("Grbl {}, axes {}", self.version, self.letters)
    }

    /// The axes that have a name here, each with its place in the control's reports.
    pub fn axes(&self) -> Vec<(Axis, u16)> {
        let letters = self.letters.chars().zip(0_u16..);
        letters
            .filter_map(|(letter, place)| Some((letter.to_string().parse().ok()?, place)))
            .collect()
    }
}

impl Grbl {
    /// Who is there; axes and buffer from `$I`.
    pub(super) async fn built(&mut self) -> Result<Built, ControllerError> {
        // Classic Grbl says nothing of its axes: it has these.
        let mut built = Built {
            classic: true,
            version: "unknown version".to_owned(),
            letters: "XYZ".to_owned(),
        };
        for message in self.wire.ask("$I").await? {
            match message {
                Message::Version(text) => built.version = text,
                Message::Buffer(bytes) => self.line_limit = bytes,
                Message::Axes(text) => (built.letters, built.classic) = (text, false),
                _ => {}
            }
        }
        self.axes = built.letters.chars().map(|letter| letter.to_string().parse().ok()).collect();
        Ok(built)
    }
}
