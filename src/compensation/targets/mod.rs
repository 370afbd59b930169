//! The kinds of values, one file each, and the one that the machine file names.

mod linuxcnc_joints;
mod linuxcnc_trunnion;
mod machine_file_checks;

use self::linuxcnc_joints::LinuxcncJoints;
use self::linuxcnc_trunnion::LinuxcncTrunnion;
use super::target::{CompensationTarget, TargetError};
use crate::setup::{CompensationConfig, MachineFile};

/// Opens the values of `kind`; without it, the only ones of the machine file.
///
/// # Errors
/// The machine file describes no such values; the control's own configuration cannot be read or is not supported.
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
        CompensationConfig::LinuxcncJoints(keys) => Box::new(LinuxcncJoints::open(file, keys)?),
    })
}
