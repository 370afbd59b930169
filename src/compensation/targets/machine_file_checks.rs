//! Checks of the machine file that the kinds of compensation values share.

use std::path::Path;

use crate::compensation::target::TargetError;
use crate::setup::{ControlConfig, MachineFile};
use machine::Axis;
use machine::record::machine::{AxisSense, Machine};

/// Maximum length of the difference between the direction of an axis in the machine file and in the machine frame.
const UNIT_VECTOR_TOLERANCE: f64 = 1e-9;

/// The INI file that LinuxCNC was started with.
pub fn ini_file(file: &MachineFile) -> Result<&Path, TargetError> {
    let ini = match &file.controller_section.control {
        ControlConfig::Real(control) => control.configuration_file(),
        ControlConfig::Simulated(_) => None,
    };
    ini.ok_or(TargetError::NoIniFile)
}

/// Checks that the axes are parallel to those of the machine frame, linear axes with the sense `iso` and rotary axes
/// with `rotary_sense`.
pub fn check_directions(machine: &Machine, axes: &[Axis], rotary_sense: AxisSense) -> Result<(), TargetError> {
    let is_other = |axis: &&Axis| {
        machine.axes.get(axis).is_some_and(|stated| {
            let sense = if axis.is_linear() { AxisSense::Iso } else { rotary_sense };
            let direction = nalgebra::Vector3::from(stated.direction);
            let deviation = direction.normalize() - axis.nominal_direction();
            stated.positive != sense || (direction.norm() > 0.0 && deviation.norm() > UNIT_VECTOR_TOLERANCE)
        })
    };
    match axes.iter().find(is_other) {
        Some(axis) => Err(TargetError::OtherDirection { axis: *axis }),
        None => Ok(()),
    }
}
