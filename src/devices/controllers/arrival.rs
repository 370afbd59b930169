//! Checks whether a machine is where it was sent, and computes its braking distance after a hold. Shared by
//! all controls that report positions.

use crate::controllers::ControllerError;
use machine::record::machine::{AxisSpec, Machine};
use machine::{Axis, Position};

/// Largest distance from the target at which a control counts as arrived, mm or degrees: coarser than a
/// step of any machine that can measure, and too small to cause a collision.
const ARRIVAL_TOLERANCE_MM_OR_DEG: f64 = 0.02;

/// Largest permitted distance of an axis from its target, mm or rad.
pub(in crate::controllers) fn axis_tolerance(axis: Axis, spec: Option<&AxisSpec>) -> f64 {
    let step_mm = spec.map_or(0.0, |spec| spec.resolution_um * 1e-3);
    if axis.is_linear() {
        ARRIVAL_TOLERANCE_MM_OR_DEG.max(2.0 * step_mm)
    } else {
        axis.to_mm_or_rad(ARRIVAL_TOLERANCE_MM_OR_DEG)
    }
}

/// Error that names the axis of `target` with the largest deviation, if any axis is out of tolerance.
pub(in crate::controllers) fn deviation_error(
    target: &Position,
    actual: &Position,
    tolerance: impl Fn(Axis) -> f64,
) -> Option<ControllerError> {
    let relative_deviation = |(axis, value): &(Axis, f64)| (value - actual.get_or_zero(*axis)).abs() / tolerance(*axis);
    let (axis, expected) =
        target.iter().max_by(|a, other| relative_deviation(a).total_cmp(&relative_deviation(other)))?;
    // A position of NaN must not count as arrival.
    if relative_deviation(&(axis, expected)) <= 1.0 {
        return None;
    }
    let format_coordinate = |value: f64| format!("{axis}{:.3}", axis.to_mm_or_deg(value));
    Some(ControllerError::WrongPosition {
        expected: format_coordinate(expected),
        actual: format_coordinate(actual.get_or_zero(axis)),
    })
}

/// Error if the contact is not between the start of the probing move and its rest position, axis by axis.
pub(in crate::controllers) fn contact_path_error(
    from: &Position,
    rest: &Position,
    contact: &Position,
    tolerance: impl Fn(Axis) -> f64,
) -> Option<ControllerError> {
    let clamp_to_path = |(axis, at): (Axis, f64)| {
        let (a, other) = (from.get_or_zero(axis), rest.get_or_zero(axis));
        (axis, at.clamp(a.min(other), a.max(other)))
    };
    let nearest_on_path: Position = contact.iter().map(clamp_to_path).collect();
    deviation_error(&nearest_on_path, contact, tolerance)
}

/// Braking distance of each axis from rapid at the set acceleration, v²/2a, from the machine file.
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
pub(in crate::controllers) fn into_moved_by_hand(error: ControllerError) -> ControllerError {
    match error {
        ControllerError::WrongPosition { expected, actual } => ControllerError::NotReady {
            state: format!("the machine was moved by hand: it is at {actual}, not at {expected}"),
            remedy: "do not move the machine and do not run other programs during a measurement".to_owned(),
        },
        other => other,
    }
}
