//! `[compensation.KIND]`: access to the compensation values of the control.

use serde::Deserialize;

use super::document::TomlDocument;
use super::error::MachineFileError;

/// One kind of compensation values of the control, from `[compensation.KIND]`.
#[derive(Debug, Clone)]
pub enum CompensationConfig {
    LinuxcncTrunnion(LinuxcncHalConfig),
    LinuxcncJointTables(LinuxcncHalConfig),
}

/// Access to LinuxCNC's HAL pins.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinuxcncHalConfig {
    /// Program and first arguments of the command for HAL pins; empty for `halcmd`.
    #[serde(default)]
    pub halcmd: Vec<String>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct CompensationKeys {
    /// Kinematics of a tilting rotary table in LinuxCNC; the values are HAL pins.
    linuxcnc_trunnion: Option<LinuxcncHalConfig>,
    /// Compensation files of LinuxCNC for linear axes.
    linuxcnc_joints: Option<LinuxcncHalConfig>,
}

impl CompensationConfig {
    /// Key of `[compensation]`.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::LinuxcncTrunnion(_) => "linuxcnc-trunnion",
            Self::LinuxcncJointTables(_) => "linuxcnc-joints",
        }
    }
}

pub fn read_compensation(document: &TomlDocument) -> Result<Vec<CompensationConfig>, MachineFileError> {
    let keys = document.read_section(&["compensation"], CompensationKeys::deserialize)?.unwrap_or_default();
    let CompensationKeys { linuxcnc_trunnion, linuxcnc_joints } = keys;
    let all = [
        linuxcnc_trunnion.map(CompensationConfig::LinuxcncTrunnion),
        linuxcnc_joints.map(CompensationConfig::LinuxcncJointTables),
    ];
    Ok(all.into_iter().flatten().collect())
}
