//! `[compensation]`: the kind of values in the control that compensate measured errors.

use serde::Deserialize;

use super::document::TomlDocument;
use super::error::MachineFileError;

/// `[compensation]` of the machine file.
#[derive(Debug, Clone, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum CompensationConfig {
    /// Kinematics of a tilting rotary table in LinuxCNC; the values are HAL pins.
    LinuxcncTrunnion {
        /// Program and first arguments of the command for HAL pins; empty for `halcmd`.
        #[serde(default)]
        halcmd: Vec<String>,
    },
}

pub fn read_compensation(document: &TomlDocument) -> Result<Option<CompensationConfig>, MachineFileError> {
    document.read_section(&["compensation"], CompensationConfig::deserialize)
}
