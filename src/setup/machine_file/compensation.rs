//! `[compensation]`: where the control keeps the values that compensate measured errors.

use serde::Deserialize;

use super::document::TomlDocument;
use super::error::MachineFileError;
use machine::Axis;

/// `[compensation]` of the machine file.
#[derive(Debug, Clone, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum CompensationConfig {
    /// Kinematics of a tilting rotary table in LinuxCNC; the values are HAL pins.
    LinuxcncTrunnion {
        kinematics: TrunnionModule,
        /// Program and first arguments of the command for HAL pins; empty for `halcmd`.
        #[serde(default)]
        halcmd: Vec<String>,
    },
}

/// Module in `[KINS]KINEMATICS` of LinuxCNC's INI file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
pub enum TrunnionModule {
    #[serde(rename = "xyzac-trt-kins")]
    TiltingA,
    #[serde(rename = "xyzbc-trt-kins")]
    TiltingB,
}

impl TrunnionModule {
    pub fn name(self) -> &'static str {
        match self {
            Self::TiltingA => "xyzac-trt-kins",
            Self::TiltingB => "xyzbc-trt-kins",
        }
    }

    /// The axis that tilts the table.
    pub fn tilting_axis(self) -> Axis {
        match self {
            Self::TiltingA => Axis::A,
            Self::TiltingB => Axis::B,
        }
    }
}

pub fn read_compensation(document: &TomlDocument) -> Result<Option<CompensationConfig>, MachineFileError> {
    document.read_section(&["compensation"], CompensationConfig::deserialize)
}
