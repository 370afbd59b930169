//! Path of a program's motions: whether the machine has reached its end, and whether a contact is on the
//! path. The control's log is written by its interpreter, which can be ahead of the machine.

use std::f64::consts::TAU;

use crate::controllers::{ControllerError, arrival};
use machine::record::motion::Motion;
use machine::{Axis, Position};

/// Error if the position `stands` is not the end of `motions`; a probing move ends at its contact.
pub(super) fn astray(motions: &[Motion], stands: &Position) -> Option<ControllerError> {
    let moving = motions.iter().rev().find(|motion| target(motion).is_some());
    if moving.is_none_or(|last| matches!(last, Motion::Probe { .. })) {
        return None;
    }
    away_from(&after(motions), stands)
}

/// Error if the position `stands` is not `end`.
pub(super) fn away_from(end: &Position, stands: &Position) -> Option<ControllerError> {
    arrival::astray(end, &turned(stands, end), |axis| arrival::tolerance(axis, None))
}

/// End position of the rotary axes of `motions`, if one of them turns at feed.
pub(super) fn end_of_turns(motions: &[Motion]) -> Option<Position> {
    let is_rotary = |axis: Axis| !axis.is_linear() && axis != Axis::S;
    let turns_at_feed = motions.iter().any(|motion| match motion {
        Motion::Feed { to, .. } => to.iter().any(|(axis, _)| is_rotary(axis)),
        _ => false,
    });
    turns_at_feed.then(|| after(motions).only(is_rotary))
}

/// Error if the contact at `at` is not between the start of the probing move of `motions` and its target.
pub(super) fn contact_off_path(motions: &[Motion], at: &Position) -> Option<ControllerError> {
    let probing = motions.iter().position(|motion| matches!(motion, Motion::Probe { .. }))?;
    let (from, to) = (after(&motions[..probing]), after(&motions[..=probing]));
    // The position of an axis before the first motion is not known here.
    let at = turned(at, &to).only(|axis| from.iter().any(|(known, _)| known == axis));
    if at.is_empty() {
        return None;
    }
    arrival::contact_off_path(&from, &to, &at, |axis| arrival::tolerance(axis, None))
}

/// End position of each axis that `motions` move.
fn after(motions: &[Motion]) -> Position {
    let targets = motions.iter().filter_map(target);
    targets.flat_map(Position::iter).fold(Position::new(), |at, (axis, value)| at.with(axis, value))
}

fn target(motion: &Motion) -> Option<&Position> {
    match motion {
        Motion::Rapid { to }
        | Motion::Feed { to, .. }
        | Motion::Guarded { to, .. }
        | Motion::Probe { to, .. }
        | Motion::BackOff { to, .. } => Some(to),
        Motion::Orient { .. } | Motion::Dwell { .. } => None,
    }
}

/// Returns `stands` with its rotary axes shifted by whole turns to be nearest to `end`: a rotary axis may
/// wrap.
fn turned(stands: &Position, end: &Position) -> Position {
    let near = |value: f64, wanted: f64| value + ((wanted - value) / TAU).round() * TAU;
    let ends: Vec<_> = end.iter().collect();
    let told = stands.iter().map(|(axis, value)| {
        let wanted = ends.iter().find(|(other, _)| !axis.is_linear() && *other == axis);
        (axis, wanted.map_or(value, |(_, wanted)| near(value, *wanted)))
    });
    told.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, c_deg: f64) -> Position {
        Position::new().with(Axis::X, x).with(Axis::C, c_deg.to_radians())
    }

    fn touch() -> Vec<Motion> {
        vec![
            Motion::Rapid { to: at(60.0, -90.0) },
            Motion::Guarded { to: at(30.0, -90.0), feed_mm_min: 300.0 },
            Motion::Probe { to: at(26.0, -90.0), feed_mm_min: 30.0 },
        ]
    }

    #[test]
    fn a_guarded_move_that_stopped_on_its_way_is_astray() {
        let guarded = &touch()[..2];
        assert!(astray(guarded, &at(30.001, -90.0)).is_none());
        assert!(astray(guarded, &at(30.0, 270.0)).is_none(), "an axis that wraps");
        let error = astray(guarded, &at(41.3, -90.0)).unwrap();
        assert!(error.to_string().contains("X41.300, not at X30.000"), "{error}");
        assert!(astray(guarded, &at(30.0, -89.0)).is_some());
    }

    #[test]
    fn a_touch_ends_anywhere_but_its_contact_lies_on_its_way() {
        assert!(astray(&touch(), &at(28.0, -90.0)).is_none());
        assert!(contact_off_path(&touch(), &at(28.0, -90.0)).is_none());
        // Result of another touch.
        assert!(contact_off_path(&touch(), &at(-28.0, -90.0)).is_some());
        assert!(contact_off_path(&touch(), &at(28.0, 30.0)).is_some());
    }

    #[test]
    fn a_back_off_is_where_it_was_told_to_be() {
        let mut motions = touch();
        motions.push(Motion::BackOff { to: at(30.0, -90.0), feed_mm_min: 300.0 });
        assert!(astray(&motions, &at(27.9, -90.0)).is_some());
        assert!(astray(&motions, &at(30.0, -90.0)).is_none());
        assert!(astray(&[Motion::Dwell { seconds: 1.0 }], &at(5.0, 0.0)).is_none());
    }
}
