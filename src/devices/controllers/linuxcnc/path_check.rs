//! Path of a program's motions: whether the machine has reached its end, and whether a contact is on the
//! path. The control's log is written by its interpreter, which can be ahead of the machine.

use std::f64::consts::TAU;

use crate::controllers::{ControllerError, arrival};
use machine::record::motion::Motion;
use machine::{Axis, Position};

/// Checks that `position` is the end of `motions`. Checks nothing if the last move is a probing move, because such a
/// move ends at its contact.
pub(super) fn check_end_position(motions: &[Motion], position: &Position) -> Result<(), ControllerError> {
    let moving = motions.iter().rev().find(|motion| motion_target(motion).is_some());
    if moving.is_none_or(|last| matches!(last, Motion::Probe { .. })) {
        return Ok(());
    }
    check_position(&end_position(motions), position)
}

/// Checks that `position` is `end` within the tolerance of each axis; a rotary axis may differ by whole turns.
pub(super) fn check_position(end: &Position, position: &Position) -> Result<(), ControllerError> {
    arrival::check_position(end, &unwrap_rotary_axes(position, end), |axis| arrival::axis_tolerance(axis, None))
}

/// End position of the rotary axes of `motions`; `None` if none of them turns at feed.
pub(super) fn feed_turn_end_position(motions: &[Motion]) -> Option<Position> {
    let is_rotary = |axis: Axis| !axis.is_linear() && axis != Axis::S;
    let turns_at_feed = motions.iter().any(|motion| match motion {
        Motion::Feed { to, .. } => to.iter().any(|(axis, _)| is_rotary(axis)),
        _ => false,
    });
    turns_at_feed.then(|| end_position(motions).filter_axes(is_rotary))
}

/// Checks that `contact` is between the start of the probing move of `motions` and its target, on the axes whose
/// start `motions` states. Checks nothing without a probing move.
pub(super) fn check_contact_on_path(motions: &[Motion], contact: &Position) -> Result<(), ControllerError> {
    let probing = motions.iter().position(|motion| matches!(motion, Motion::Probe { .. }));
    let Some(probing) = probing else { return Ok(()) };
    let (from, to) = (end_position(&motions[..probing]), end_position(&motions[..=probing]));
    // The position of an axis before the first motion is not known here.
    let contact = unwrap_rotary_axes(contact, &to).filter_axes(|axis| from.iter().any(|(known, _)| known == axis));
    arrival::check_contact_path(&from, &to, &contact, |axis| arrival::axis_tolerance(axis, None))
}

/// End position of each axis that `motions` move.
fn end_position(motions: &[Motion]) -> Position {
    let targets = motions.iter().filter_map(motion_target);
    targets.flat_map(Position::iter).fold(Position::new(), |at, (axis, value)| at.with(axis, value))
}

fn motion_target(motion: &Motion) -> Option<&Position> {
    match motion {
        Motion::Rapid { to }
        | Motion::Feed { to, .. }
        | Motion::Guarded { to, .. }
        | Motion::Probe { to, .. }
        | Motion::BackOff { to, .. } => Some(to),
        Motion::OrientSpindle { .. } | Motion::Dwell { .. } => None,
    }
}

/// Returns `position` with its rotary axes shifted by whole turns to be nearest to `end`: a rotary axis may
/// wrap.
fn unwrap_rotary_axes(position: &Position, end: &Position) -> Position {
    let nearest_turn = |value: f64, target: f64| value + ((target - value) / TAU).round() * TAU;
    let ends: Vec<_> = end.iter().collect();
    let unwrapped = position.iter().map(|(axis, value)| {
        let target = ends.iter().find(|(other, _)| !axis.is_linear() && *other == axis);
        (axis, target.map_or(value, |(_, target)| nearest_turn(value, *target)))
    });
    unwrapped.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn position_at(x: f64, c_deg: f64) -> Position {
        Position::new().with(Axis::X, x).with(Axis::C, c_deg.to_radians())
    }

    fn touch_motions() -> Vec<Motion> {
        vec![
            Motion::Rapid { to: position_at(60.0, -90.0) },
            Motion::Guarded { to: position_at(30.0, -90.0), feed_mm_min: 300.0 },
            Motion::Probe { to: position_at(26.0, -90.0), feed_mm_min: 30.0 },
        ]
    }

    #[test]
    fn guarded_move_that_is_not_at_its_target_is_refused() {
        let guarded = &touch_motions()[..2];
        assert!(check_end_position(guarded, &position_at(30.001, -90.0)).is_ok());
        assert!(check_end_position(guarded, &position_at(30.0, 270.0)).is_ok(), "an axis that wraps");
        let error = check_end_position(guarded, &position_at(41.3, -90.0)).unwrap_err();
        assert!(error.to_string().contains("X41.300, not at X30.000"), "{error}");
        assert!(check_end_position(guarded, &position_at(30.0, -89.0)).is_err());
    }

    #[test]
    fn contact_off_the_path_of_the_touch_is_refused() {
        assert!(check_end_position(&touch_motions(), &position_at(28.0, -90.0)).is_ok());
        assert!(check_contact_on_path(&touch_motions(), &position_at(28.0, -90.0)).is_ok());
        // Result of another touch.
        assert!(check_contact_on_path(&touch_motions(), &position_at(-28.0, -90.0)).is_err());
        assert!(check_contact_on_path(&touch_motions(), &position_at(28.0, 30.0)).is_err());
    }

    #[test]
    fn back_off_must_end_at_its_target() {
        let mut motions = touch_motions();
        motions.push(Motion::BackOff { to: position_at(30.0, -90.0), feed_mm_min: 300.0 });
        assert!(check_end_position(&motions, &position_at(27.9, -90.0)).is_err());
        assert!(check_end_position(&motions, &position_at(30.0, -90.0)).is_ok());
        assert!(check_end_position(&[Motion::Dwell { seconds: 1.0 }], &position_at(5.0, 0.0)).is_ok());
    }
}
