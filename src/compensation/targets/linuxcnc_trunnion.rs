//! Kinematics of a tilting rotary table in LinuxCNC.

use super::machine_file_checks::{check_directions, ini_file};
use crate::compensation::target::{CompensationTarget, TargetError};
use crate::setup::{LinuxcncHalConfig, MachineFile};
use devices::compensation::ValueToWrite;
use devices::compensation::linuxcnc_trunnion::{TrunnionState, TrunnionTarget};
use machine::Axis;
use machine::kinematics::KinematicChain;
use machine::record::machine::Machine;
use methods::compensation::{ControlModel, ControlValue, TrunnionPins};

/// Compensation values in the HAL pins of LinuxCNC's kinematics of a tilting rotary table.
#[derive(Debug)]
pub struct LinuxcncTrunnion<'a> {
    machine: &'a Machine,
    trunnion: TrunnionTarget,
}

impl<'a> LinuxcncTrunnion<'a> {
    /// # Errors
    /// The INI file cannot be read or is not supported.
    pub fn open(file: &'a MachineFile, keys: &LinuxcncHalConfig) -> Result<Self, TargetError> {
        Ok(Self { machine: &file.machine, trunnion: TrunnionTarget::new(ini_file(file)?, &keys.halcmd)? })
    }
}

impl CompensationTarget for LinuxcncTrunnion<'_> {
    fn kind(&self) -> &'static str {
        "linuxcnc-trunnion"
    }

    fn describe(&self) -> String {
        self.trunnion.describe()
    }

    fn read(&self) -> Result<ControlModel, TargetError> {
        let state = self.trunnion.read()?;
        check_same_kinematics(self.machine, &state)?;
        let TrunnionState {
            tilting_axis, x_rot_point, y_rot_point, z_rot_point, x_or_y_offset: offset, z_offset, ..
        } = state;
        let pins = TrunnionPins { x_rot_point, y_rot_point, z_rot_point, offset, z_offset };
        Ok(ControlModel::linuxcnc_trunnion(tilting_axis, pins))
    }

    fn check_writable(&self) -> Result<(), TargetError> {
        Ok(self.trunnion.check_writable()?)
    }

    /// Writes and reads back one pin after another; an error leaves the earlier pins changed.
    fn write(&self, values: &[ValueToWrite<'_>]) -> Result<(), TargetError> {
        Ok(values.iter().try_for_each(|value| self.trunnion.write(value.name, value.text))?)
    }

    fn sets_tool_centre(&self) -> bool {
        true
    }

    fn advice_after_write(&self) -> String {
        "Measure again: only a measurement shows that the values are correct. LinuxCNC loses the values when it ends, \
         and reads the values in its HAL files at each start: enter the present values in a HAL file (`trued \
         compensate status --hal FILE` writes the lines)"
            .to_owned()
    }

    /// Lines of a HAL file that set the pins.
    fn startup_lines(&self, values: &[ControlValue]) -> Option<String> {
        Some(values.iter().map(|value| format!("setp {} {}\n", value.name, value.text)).collect())
    }
}

/// Checks that the control turns the table as the machine file states.
fn check_same_kinematics(machine: &Machine, state: &TrunnionState) -> Result<(), TargetError> {
    let tilt = state.tilting_axis;
    let chain = KinematicChain::new(machine)?;
    let branch = chain.topology().workpiece_branch();
    let is_tool_turned = chain.topology().tool_branch().iter().any(|axis| !axis.is_linear() && *axis != Axis::S);
    // No linear axis is between the two rotary axes, or between them and the workpiece.
    if !branch.ends_with(&[tilt, Axis::C])
        || branch.iter().filter(|axis| !axis.is_linear()).count() != 2
        || is_tool_turned
    {
        return Err(TargetError::OtherTopology { tilt, topology: machine.topology.clone() });
    }
    check_directions(machine, &[Axis::X, Axis::Y, Axis::Z, tilt, Axis::C], state.sense)
}
