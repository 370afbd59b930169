//! The control that holds the values, as `[compensation]` of the machine file describes it.

use devices::compensation::linuxcnc_trunnion::{TrunnionError, TrunnionState, TrunnionTarget};
use machine::Axis;
use machine::kinematics::{KinematicChain, KinematicsError};
use machine::record::machine::{AxisSense, Machine};
use methods::compensation::{ControlModel, ControlValue, TrunnionPins};

use crate::setup::{CompensationConfig, ControlConfig, MachineFile};

/// Greatest difference of a direction in the machine file from that of the machine frame.
const DIRECTION_TOLERANCE: f64 = 1e-9;

#[derive(Debug, thiserror::Error)]
pub enum TargetError {
    #[error("the machine file has no section [compensation]")]
    NotConfigured,
    #[error("[compensation] is for LinuxCNC, and [controller] names no INI file of it")]
    NoIniFile,
    #[error(transparent)]
    Trunnion(#[from] TrunnionError),
    #[error(transparent)]
    Kinematics(#[from] KinematicsError),
    #[error(
        "the kinematics of the control are for a table that tilts on {tilt} and carries C; the machine is {topology}"
    )]
    OtherTopology { tilt: Axis, topology: String },
    #[error("the machine file states {axis} in another direction or sense than the control")]
    OtherDirection { axis: Axis },
}

impl TargetError {
    /// What to do next.
    pub fn remedy(&self) -> String {
        let text = match self {
            Self::NotConfigured => "state the control's kinematics: [compensation] with kind = \"linuxcnc-trunnion\"",
            Self::NoIniFile => "set [controller] ini to the INI file that LinuxCNC was started with",
            Self::Trunnion(error) => return error.remedy(),
            Self::Kinematics(_) => "correct [machine] and [axes] in the machine file",
            Self::OtherTopology { .. } => "correct topology in [machine], or remove [compensation]",
            Self::OtherDirection { .. } => {
                "correct `direction` and `positive` of the axis in the machine file: LinuxCNC's trt-kins need axes along \
                 X, Y and Z, and count rotary axes against ISO 841 (`reversed`) unless the pin conventional-directions \
                 is 1"
            }
        };
        text.to_owned()
    }
}

/// A control whose values can be read and written.
#[derive(Debug)]
pub struct CompensationTarget<'a> {
    machine: &'a Machine,
    trunnion: TrunnionTarget,
}

impl<'a> CompensationTarget<'a> {
    /// # Errors
    /// The machine file describes no target; the control's own configuration cannot be read or is not supported.
    pub fn open(file: &'a MachineFile) -> Result<Self, TargetError> {
        let CompensationConfig::LinuxcncTrunnion { halcmd } =
            file.compensation.as_ref().ok_or(TargetError::NotConfigured)?;
        let ini = match &file.controller_section.control {
            ControlConfig::Real(control) => control.configuration_file(),
            ControlConfig::Simulated(_) => None,
        };
        let trunnion = TrunnionTarget::new(ini.ok_or(TargetError::NoIniFile)?, halcmd)?;
        Ok(Self { machine: &file.machine, trunnion })
    }

    /// INI file and command of the control.
    pub fn describe(&self) -> String {
        self.trunnion.describe()
    }

    /// The values that the control holds now, and what they mean.
    ///
    /// # Errors
    /// The control cannot be read; its kinematics are not those of the machine file.
    pub fn read(&self) -> Result<ControlModel, TargetError> {
        let state = self.trunnion.read()?;
        check_same_kinematics(self.machine, &state)?;
        let TrunnionState { tilting_axis, x_rot_point, y_rot_point, z_rot_point, offset, z_offset, .. } = state;
        let pins = TrunnionPins { x_rot_point, y_rot_point, z_rot_point, offset, z_offset };
        Ok(ControlModel::linuxcnc_trunnion(tilting_axis, pins))
    }

    /// Sets one value and reads it back.
    ///
    /// # Errors
    /// The machine moves, or the control applies its values now; the value cannot be set, or reads back otherwise.
    pub fn write(&self, name: &str, value_mm: f64) -> Result<(), TargetError> {
        Ok(self.trunnion.write(name, value_mm)?)
    }

    /// Lines of a HAL file that set the values, for each start of LinuxCNC.
    pub fn hal_lines(values: &[ControlValue]) -> String {
        values.iter().map(|value| format!("setp {} {}\n", value.name, value.present_mm)).collect()
    }

    /// Refuses a write that would move the machine.
    ///
    /// # Errors
    /// The machine moves, or the control applies its values now.
    pub fn check_writable(&self) -> Result<(), TargetError> {
        Ok(self.trunnion.check_writable()?)
    }
}

/// Checks that the control turns the table as the machine file states.
fn check_same_kinematics(machine: &Machine, state: &TrunnionState) -> Result<(), TargetError> {
    let tilt = state.tilting_axis;
    let chain = KinematicChain::new(machine)?;
    let branch = chain.topology().workpiece_branch();
    let is_tool_turned = chain.topology().tool_branch().iter().any(|axis| !axis.is_linear() && *axis != Axis::S);
    // No linear axis between the rotary ones, nor nearer to the workpiece.
    if !branch.ends_with(&[tilt, Axis::C])
        || branch.iter().filter(|axis| !axis.is_linear()).count() != 2
        || is_tool_turned
    {
        return Err(TargetError::OtherTopology { tilt, topology: machine.topology.clone() });
    }
    let is_other = |axis: &Axis| {
        machine.axes.get(axis).is_some_and(|stated| {
            let sense = if axis.is_linear() { AxisSense::Iso } else { state.sense };
            let direction = nalgebra::Vector3::from(stated.direction);
            let deviation = direction.normalize() - axis.nominal_direction();
            stated.positive != sense || (direction.norm() > 0.0 && deviation.norm() > DIRECTION_TOLERANCE)
        })
    };
    match [Axis::X, Axis::Y, Axis::Z, tilt, Axis::C].into_iter().find(is_other) {
        Some(axis) => Err(TargetError::OtherDirection { axis }),
        None => Ok(()),
    }
}
