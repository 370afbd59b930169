//! Checks whether a machine is where it was sent, and computes its braking distance after a hold. Shared by
//! all controls that report positions.

use crate::controllers::ControllerError;
use machine::record::machine::{AxisSpec, Machine};
use machine::{Axis, Position};

/// Largest distance from the target at which a control counts as arrived, mm or degrees: coarser than a
/// step of any machine that can measure, and too small to cause a collision.
const ARRIVAL_TOLERANCE: f64 = 0.02;

/// Largest permitted distance of an axis from its target, mm or rad.
pub(in crate::controllers) fn tolerance(axis: Axis, spec: Option<&AxisSpec>) -> f64 {
    let step_mm = spec.map_or(0.0, |spec| spec.resolution_um * 1e-3);
    if axis.is_linear() {
        ARRIVAL_TOLERANCE.max(2.0 * step_mm)
    } else {
        axis.from_edge(ARRIVAL_TOLERANCE)
    }
}

/// Error that names the axis of `target` with the largest deviation, if any axis is out of tolerance.
pub(in crate::controllers) fn astray(
    target: &Position,
    stands: &Position,
    tolerance: impl Fn(Axis) -> f64,
) -> Option<ControllerError> {
    let off = |(axis, value): &(Axis, f64)| (value - stands.at(*axis)).abs() / tolerance(*axis);
    let (axis, wanted) = target.iter().max_by(|one, other| off(one).total_cmp(&off(other)))?;
    // A position of NaN must not count as arrival.
    if off(&(axis, wanted)) <= 1.0 {
        return None;
    }
    let told = |value: f64| format!("{axis}{:.3}", axis.to_edge(value));
    Some(ControllerError::WrongPosition { wanted: told(wanted), stands: told(stands.at(axis)) })
}

/// Error if the contact is not between the start of the probing move and its rest position, axis by axis.
pub(in crate::controllers) fn contact_off_path(
    from: &Position,
    rest: &Position,
    contact: &Position,
    tolerance: impl Fn(Axis) -> f64,
) -> Option<ControllerError> {
    let nearest = |(axis, at): (Axis, f64)| {
        let (one, other) = (from.at(axis), rest.at(axis));
        (axis, at.clamp(one.min(other), one.max(other)))
    };
    let on_the_way: Position = contact.iter().map(nearest).collect();
    astray(&on_the_way, contact, tolerance)
}

/// Braking distance of each axis from rapid at the set acceleration, v²/2a, from the machine file.
pub(in crate::controllers) fn braking(machine: &Machine) -> String {
    let braking = machine.axes.iter().filter(|(axis, _)| **axis != Axis::S).map(|(axis, spec)| {
        let speed = spec.rapid_per_min / 60.0;
        let unit = if axis.is_linear() { "mm" } else { "deg" };
        format!("{axis} {:.1} {unit}", speed * speed / (2.0 * spec.acceleration_per_s2))
    });
    let braking: Vec<String> = braking.collect();
    format!("brakes on the path and stays; at most {}", braking.join(", "))
}

/// Converts `WrongPosition` to `NotReady`: between two blocks only a person or another program moves the machine.
pub(in crate::controllers) fn moved_by_hand(error: ControllerError) -> ControllerError {
    match error {
        ControllerError::WrongPosition { wanted, stands } => ControllerError::NotReady {
            state: format!("it was moved by hand: it stands at {stands}, not at {wanted}"),
            remedy: "leave the machine to trued while it measures".to_owned(),
        },
        other => other,
    }
}
