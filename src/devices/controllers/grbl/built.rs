//! Version and axes of a control, as `$I` reports them.

use super::driver::Grbl;
use super::message::Message;
use crate::controllers::ControllerError;
use machine::Axis;

/// Version and axes of a control.
pub(super) struct FirmwareInfo {
    /// Whether the control is classic Grbl, the version for three axes before grblHAL.
    pub classic: bool,
    pub version: String,
    /// Axis letters in the order of the control's reports.
    pub letters: String,
}

impl FirmwareInfo {
    pub fn identity(&self) -> String {
        format!("Grbl {}, axes {}", self.version, self.letters)
    }

    /// Axes that have a name in `trued`, each with its index in the control's reports.
    pub fn axes(&self) -> Vec<(Axis, u16)> {
        let letters = self.letters.chars().zip(0_u16..);
        letters
            .filter_map(|(letter, place)| Some((letter.to_string().parse().ok()?, place)))
            .collect()
    }
}

impl Grbl {
    /// Reads version, axes and buffer size by `$I`.
    pub(super) async fn built(&mut self) -> Result<FirmwareInfo, ControllerError> {
        // Classic Grbl does not report its axes: it has X, Y and Z.
        let mut built = FirmwareInfo {
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
