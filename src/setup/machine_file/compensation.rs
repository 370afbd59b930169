//! `[compensation.KIND]`: access to the compensation values of the control.

use serde::Deserialize;

use super::document::TomlDocument;
use super::error::MachineFileError;
use devices::controllers::WorkOffsetSlot;
use planning::gcode::Dialect;

/// One kind of compensation values of the control, from `[compensation.KIND]`.
#[derive(Debug, Clone)]
pub enum CompensationConfig {
    /// Kinematics of a tilting rotary table in LinuxCNC; the values are HAL pins.
    LinuxcncTrunnion(LinuxcncHalConfig),
    /// Compensation files of LinuxCNC for linear axes.
    LinuxcncJointTables(LinuxcncHalConfig),
    /// Work offset of LinuxCNC or grblHAL, set by `G10 L2`.
    WorkOffset(WorkOffsetConfig),
}

/// The work offset whose zero is the centre of rotation.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorkOffsetConfig {
    pub slot: WorkOffsetSlot,
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
    /// Work offset of LinuxCNC or grblHAL, set by `G10 L2`.
    work_offset: Option<WorkOffsetConfig>,
}

impl CompensationConfig {
    /// Key of `[compensation]`; it also names the kind of values in the journal and in requests (`target`).
    pub fn kind(&self) -> &'static str {
        match self {
            Self::LinuxcncTrunnion(_) => "linuxcnc-trunnion",
            Self::LinuxcncJointTables(_) => "linuxcnc-joints",
            Self::WorkOffset(_) => "work-offset",
        }
    }

    /// Whether the control applies the values to the axis positions that the readings contain: true for the
    /// compensation files of linear axes alone.
    pub fn is_in_readings(&self) -> bool {
        matches!(self, Self::LinuxcncJointTables(_))
    }

    /// Whether the values are read and written over the link of the control.
    pub fn needs_control_link(&self) -> bool {
        matches!(self, Self::WorkOffset(_))
    }
}

/// Configured kinds of compensation values; empty without `[compensation]`. `dialect`: name of the control's dialect,
/// whose own work offset and those after it are refused as the slot.
pub fn read_compensation(document: &TomlDocument, dialect: &str) -> Result<Vec<CompensationConfig>, MachineFileError> {
    let keys = document.read_section(&["compensation"], CompensationKeys::deserialize)?.unwrap_or_default();
    let CompensationKeys { linuxcnc_trunnion, linuxcnc_joints, work_offset } = keys;
    if let Some(WorkOffsetConfig { slot }) = work_offset {
        check_slot(document, slot, dialect)?;
    }
    let all = [
        linuxcnc_trunnion.map(CompensationConfig::LinuxcncTrunnion),
        linuxcnc_joints.map(CompensationConfig::LinuxcncJointTables),
        work_offset.map(CompensationConfig::WorkOffset),
    ];
    Ok(all.into_iter().flatten().collect())
}

/// Refuses the slot that the programs of the dialect use, and the slots of higher P numbers: a control without G59.1
/// to G59.3 has none after G59.
fn check_slot(document: &TomlDocument, slot: WorkOffsetSlot, dialect: &str) -> Result<(), MachineFileError> {
    // An unknown dialect is refused elsewhere.
    let Ok(dialect) = Dialect::from_name(dialect) else { return Ok(()) };
    let reserved = dialect.work_offset();
    let usable: Vec<&str> =
        WorkOffsetSlot::all().map(WorkOffsetSlot::name).take_while(|name| *name != reserved).collect();
    if usable.contains(&slot.name()) {
        return Ok(());
    }
    let why = format!("must be one of {}: programs of trued use {reserved}", usable.join(", "));
    Err(document.value_error(&["compensation", "work-offset", "slot"], why))
}
