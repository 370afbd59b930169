//! The kinds of compensation values, one module for each, and the selection by the machine file.

mod linuxcnc_joints;
mod linuxcnc_trunnion;
mod machine_file_checks;
mod work_offset;

use self::linuxcnc_joints::LinuxcncJointTables;
use self::linuxcnc_trunnion::LinuxcncTrunnion;
use self::work_offset::WorkOffsetTarget;
use super::target::{CompensationTarget, TargetError};
use crate::setup::{CompensationConfig, MachineFile};

/// Opens the compensation values of `kind`. Without `kind`, opens the only kind in the machine file.
///
/// # Errors
/// The machine file has no section for this kind, or several sections and no `kind` is given; the control's own
/// configuration cannot be read or is not supported.
pub fn open_target<'a>(
    file: &'a MachineFile,
    kind: Option<&str>,
) -> Result<Box<dyn CompensationTarget + 'a>, TargetError> {
    Ok(match target_config(file, kind)? {
        CompensationConfig::LinuxcncTrunnion(keys) => Box::new(LinuxcncTrunnion::open(file, keys)?),
        CompensationConfig::LinuxcncJointTables(keys) => Box::new(LinuxcncJointTables::open(file, keys)?),
        CompensationConfig::WorkOffset(keys) => Box::new(WorkOffsetTarget::new(file, keys)?),
    })
}

/// Whether the values of `kind` are read and written over the link of the control, which only the holder of the
/// machine's lock may open; false also without a section for `kind`. `kind`: as for [`open_target`].
pub fn needs_control_link(file: &MachineFile, kind: Option<&str>) -> bool {
    target_config(file, kind).is_ok_and(CompensationConfig::needs_control_link)
}

fn target_config<'a>(file: &'a MachineFile, kind: Option<&str>) -> Result<&'a CompensationConfig, TargetError> {
    match (kind, &file.compensation[..]) {
        (Some(kind), all) => {
            all.iter().find(|own| own.kind() == kind).ok_or_else(|| TargetError::NoSuchTarget(kind.to_owned()))
        }
        (None, []) => Err(TargetError::NotConfigured),
        (None, [only]) => Ok(only),
        (None, several) => {
            let kinds: Vec<&str> = several.iter().map(CompensationConfig::kind).collect();
            Err(TargetError::SeveralTargets(kinds.join(", ")))
        }
    }
}
