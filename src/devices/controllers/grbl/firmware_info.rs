//! Version and axes of a control, as `$I` reports them.

use super::driver::Grbl;
use super::message::GrblMessage;
use crate::controllers::ControllerError;
use machine::Axis;

/// Version and axes of a control.
pub(super) struct FirmwareInfo {
    /// Whether the control is classic Grbl, the version for three axes before grblHAL.
    pub is_classic: bool,
    pub version: String,
    /// Axis letters in the order of the control's reports.
    pub axis_letters: String,
}

impl FirmwareInfo {
    pub fn identity(&self) -> String {
        format!("Grbl {}, axes {}", self.version, self.axis_letters)
    }

    /// Axes that have a name in `trued`, each with its index in the control's reports.
    pub fn axes(&self) -> Vec<(Axis, u16)> {
        let axis_letters = self.axis_letters.chars().zip(0_u16..);
        axis_letters.filter_map(|(letter, index)| Some((letter.to_string().parse().ok()?, index))).collect()
    }
}

impl Grbl {
    /// Reads version, axes and buffer size by `$I`.
    pub(super) async fn read_firmware_info(&mut self) -> Result<FirmwareInfo, ControllerError> {
        // Classic Grbl does not report its axes: it has X, Y and Z.
        let mut firmware =
            FirmwareInfo { is_classic: true, version: "unknown version".to_owned(), axis_letters: "XYZ".to_owned() };
        for message in self.connection.send_line("$I").await? {
            match message {
                GrblMessage::Version(text) => firmware.version = text,
                GrblMessage::BufferSize(bytes) => self.max_line_bytes = bytes,
                GrblMessage::Axes(text) => (firmware.axis_letters, firmware.is_classic) = (text, false),
                _ => {}
            }
        }
        self.report_axes = firmware.axis_letters.chars().map(|letter| letter.to_string().parse().ok()).collect();
        Ok(firmware)
    }
}
