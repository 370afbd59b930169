//! Checks whether a machine is where it was sent, and computes its braking distance after a hold. Shared by
//! all controls that report positions.

use std::collections::BTreeMap;

use super::control_clock::ControlClock;
use crate::controllers::ControllerError;
use machine::record::machine::{Machine, StatedAxis};
use machine::{Axis, Position};

/// Largest distance from the target at which an axis counts as arrived, mm or degrees: coarser than a step of any
/// machine that can measure, and too small to cause a collision.
const ARRIVAL_TOLERANCE_MM_OR_DEG: f64 = 0.02;

/// Largest permitted distance of an axis from its target, mm or rad; at least two steps of a linear axis.
pub(in crate::controllers) fn axis_tolerance(axis: Axis, spec: Option<&StatedAxis>) -> f64 {
    let step_mm = spec.map_or(0.0, |spec| spec.resolution_um * 1e-3);
    if axis.is_linear() {
        ARRIVAL_TOLERANCE_MM_OR_DEG.max(2.0 * step_mm)
    } else {
        axis.to_mm_or_rad(ARRIVAL_TOLERANCE_MM_OR_DEG)
    }
}

/// Checks that `actual` is `target` within `tolerance`. The error names the axis with the largest deviation.
pub(in crate::controllers) fn check_position(
    target: &Position,
    actual: &Position,
    tolerance: impl Fn(Axis) -> f64,
) -> Result<(), ControllerError> {
    let relative_deviation = |(axis, value): &(Axis, f64)| (value - actual.get_or_zero(*axis)).abs() / tolerance(*axis);
    let largest = target.iter().max_by(|a, other| relative_deviation(a).total_cmp(&relative_deviation(other)));
    let Some((axis, expected)) = largest else { return Ok(()) };
    // A position of NaN must not count as arrival.
    if relative_deviation(&(axis, expected)) <= 1.0 {
        return Ok(());
    }
    let format_coordinate = |value: f64| format!("{axis}{:.3}", axis.to_mm_or_deg(value));
    Err(ControllerError::WrongPosition {
        expected: format_coordinate(expected),
        actual: format_coordinate(actual.get_or_zero(axis)),
    })
}

/// Checks that the contact is between the start of the probing move and its rest position, axis by axis.
pub(in crate::controllers) fn check_contact_path(
    from: &Position,
    rest: &Position,
    contact: &Position,
    tolerance: impl Fn(Axis) -> f64,
) -> Result<(), ControllerError> {
    let clamp_to_path = |(axis, at): (Axis, f64)| {
        let (a, other) = (from.get_or_zero(axis), rest.get_or_zero(axis));
        (axis, at.clamp(a.min(other), a.max(other)))
    };
    let nearest_on_path: Position = contact.iter().map(clamp_to_path).collect();
    check_position(&nearest_on_path, contact, tolerance)
}

/// Axes of a machine without the spindle, their tolerances, and the machine's last position and orientation.
pub(in crate::controllers) struct AxisMonitor {
    /// Axes of the machine file, without the spindle.
    pub axes_without_spindle: Vec<Axis>,
    /// Largest permitted distance of each axis from its target, mm or rad.
    tolerances: BTreeMap<Axis, f64>,
    /// Last position of the machine at a standstill.
    pub standstill_position: Position,
    /// Orientation of the spindle, rad, once it was commanded.
    pub spindle_rad: Option<f64>,
    pub clock: ControlClock,
}

impl AxisMonitor {
    pub fn new(machine: &Machine) -> Self {
        let specs = machine.axes.iter().filter(|(axis, _)| **axis != Axis::S);
        let tolerances: BTreeMap<_, _> = specs.map(|(axis, spec)| (*axis, axis_tolerance(*axis, Some(spec)))).collect();
        Self {
            axes_without_spindle: tolerances.keys().copied().collect(),
            tolerances,
            standstill_position: Position::new(),
            spindle_rad: None,
            clock: ControlClock::default(),
        }
    }

    /// Largest permitted distance of an axis from its target, mm or rad; infinite for the spindle and for axes that
    /// the machine file does not name: they are not checked.
    fn tolerance(&self, axis: Axis) -> f64 {
        self.tolerances.get(&axis).copied().unwrap_or(f64::INFINITY)
    }

    pub fn check_position(&self, target: &Position, actual: &Position) -> Result<(), ControllerError> {
        check_position(target, actual, |axis| self.tolerance(axis))
    }

    /// Checks that the last standstill position is `target`; nothing is read from the control.
    pub fn check_standstill_position(&self, target: &Position) -> Result<(), ControllerError> {
        self.check_position(target, &self.standstill_position)
    }

    /// Checks that a contact is on the path between `from` and `to`.
    pub fn check_contact_on_path(
        &self,
        from: &Position,
        to: &Position,
        contact: &Position,
    ) -> Result<(), ControllerError> {
        check_contact_path(from, to, contact, |axis| self.tolerance(axis))
    }

    /// Restricts a position to the axes of the machine file without the spindle.
    pub fn machine_axes_only(&self, position: &Position) -> Position {
        position.filter_axes(|axis| self.axes_without_spindle.contains(&axis))
    }

    /// Returns `position` with the last commanded orientation of the spindle, if an orientation was commanded.
    pub fn with_spindle_orientation(&self, position: impl IntoIterator<Item = (Axis, f64)>) -> Position {
        position.into_iter().chain(self.spindle_rad.map(|s| (Axis::S, s))).collect()
    }
}

/// Sentence with the braking distance of each axis from rapid at the set acceleration, v²/2a, from the machine file.
pub(in crate::controllers) fn describe_braking_distances(machine: &Machine) -> String {
    let braking = machine.axes.iter().filter(|(axis, _)| **axis != Axis::S).map(|(axis, spec)| {
        let speed = spec.rapid_per_min / 60.0;
        let unit = if axis.is_linear() { "mm" } else { "deg" };
        format!("{axis} {:.1} {unit}", speed * speed / (2.0 * spec.acceleration_per_s2))
    });
    let braking: Vec<String> = braking.collect();
    format!("the machine decelerates along the path and stays; braking distance at most {}", braking.join(", "))
}

/// Converts `WrongPosition` to `NotReady`: between two blocks only a person or another program moves the machine.
pub(in crate::controllers) fn moved_between_blocks_error(error: ControllerError) -> ControllerError {
    match error {
        ControllerError::WrongPosition { expected, actual } => ControllerError::not_ready(
            format!("the machine was moved by hand: it is at {actual}, not at {expected}"),
            "do not move the machine and do not run other programs during a measurement",
        ),
        other => other,
    }
}
