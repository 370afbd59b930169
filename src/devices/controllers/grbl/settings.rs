//! Version and axes of a control, as `$I` reports them, and its settings, as `$$` lists them. Setting
//! numbers and meanings are those of grblHAL (`settings.h`).

use std::collections::BTreeMap;

use super::driver::GrblDriver;
use super::message::GrblMessage;
use crate::controllers::ControllerError;
use machine::Axis;

/// Mask of `$21`: hard limits are on.
pub(super) const HARD_LIMITS_MASK: u32 = 1;
/// Mask of `$22`: homing is on.
pub(super) const HOMING_ENABLED_MASK: u32 = 1;
/// Mask of `$22`: machine zero is at the homing switch.
pub(super) const ZERO_AT_SWITCH_MASK: u32 = 1 << 3;
/// Mask of `$22`: axes without a switch are homed at their present position.
pub(super) const MANUAL_HOMING_MASK: u32 = 1 << 5;

/// Setting numbers of the minimum and of the maximum travel of the first axis, an extension of the simulated
/// control: its travel may extend to both sides of zero, which grblHAL does not support.
pub(super) const FIRST_SIMULATED_TRAVEL_SETTINGS: [u16; 2] = [9000, 9050];

/// Settings with a numeric value, by number.
pub(super) struct GrblSettings(pub BTreeMap<u16, f64>);

impl GrblSettings {
    pub fn value(&self, number: u16) -> Option<f64> {
        self.0.get(&number).copied()
    }

    /// Whether the setting has any bit of `mask`; false if the setting is not reported.
    pub fn has_bit(&self, setting_number: u16, mask: u32) -> bool {
        self.value_as_bits(setting_number) & mask != 0
    }

    fn value_as_bits(&self, number: u16) -> u32 {
        // The conversion is exact: settings that hold bits are small whole numbers.
        self.value(number).unwrap_or_default() as u32
    }
}

/// Version and axes of a control.
pub(super) struct FirmwareInfo {
    /// Whether the control is classic Grbl, the version for three axes before grblHAL.
    pub is_classic: bool,
    /// `unknown version` if the control does not report the version.
    pub version: String,
    /// Axis letters in the order of the control's reports.
    pub axis_letters: String,
}

impl FirmwareInfo {
    pub fn identity(&self) -> String {
        format!("Grbl {}, axes {}", self.version, self.axis_letters)
    }

    /// Axes that have a name in `trued`, each with its index in the control's reports.
    pub fn axes_with_report_index(&self) -> Vec<(Axis, u16)> {
        let axis_letters = self.axis_letters.chars().zip(0_u16..);
        axis_letters.filter_map(|(letter, index)| Some((letter.to_string().parse().ok()?, index))).collect()
    }
}

impl GrblDriver {
    /// Reads version, axes and buffer size by `$I`.
    pub(super) async fn read_firmware_info(&mut self) -> Result<FirmwareInfo, ControllerError> {
        // Classic Grbl does not report its axes: it has X, Y and Z.
        let mut firmware =
            FirmwareInfo { is_classic: true, version: "unknown version".to_owned(), axis_letters: "XYZ".to_owned() };
        for message in self.connection.send_line("$I").await? {
            match message {
                GrblMessage::Version(text) => firmware.version = text,
                GrblMessage::MaxLineBytes(bytes) => self.max_line_bytes = bytes,
                GrblMessage::AxisLetters(text) => (firmware.axis_letters, firmware.is_classic) = (text, false),
                _ => {}
            }
        }
        self.axes_in_report_order =
            firmware.axis_letters.chars().map(|letter| letter.to_string().parse().ok()).collect();
        Ok(firmware)
    }

    pub(super) async fn read_settings(&mut self) -> Result<GrblSettings, ControllerError> {
        let messages = self.connection.send_line("$$").await?.into_iter();
        let settings = messages.filter_map(|message| match message {
            GrblMessage::Setting(number, value) => Some((number, value)),
            _ => None,
        });
        Ok(GrblSettings(settings.collect()))
    }
}
