//! The kinds of compensation values, one module for each, and the selection by the machine file.

mod linuxcnc_joints;
mod linuxcnc_trunnion;
mod machine_file_checks;

use self::linuxcnc_joints::LinuxcncJointTables;
use self::linuxcnc_trunnion::LinuxcncTrunnion;
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
    let config = match (kind, &file.compensation[..]) {
        (Some(kind), all) => {
            all.iter().find(|own| own.kind() == kind).ok_or_else(|| TargetError::NoSuchTarget(kind.to_owned()))?
        }
        (None, []) => return Err(TargetError::NotConfigured),
        (None, [only]) => only,
        (None, several) => {
            let kinds: Vec<&str> = several.iter().map(CompensationConfig::kind).collect();
            return Err(TargetError::SeveralTargets(kinds.join(", ")));
        }
    };
    Ok(match config {
        CompensationConfig::LinuxcncTrunnion(keys) => Box::new(LinuxcncTrunnion::open(file, keys)?),
        CompensationConfig::LinuxcncJointTables(keys) => Box::new(LinuxcncJointTables::open(file, keys)?),
    })
}
