//! Motions of a block during planning.

use machine::record::motion::Motion;
use machine::{Axis, Position};

/// Maximum difference of equal positions, mm or rad.
pub(super) const EQUAL_POSITION_TOLERANCE_MM_OR_RAD: f64 = 1e-9;

pub(super) fn z_position(z: f64) -> Position {
    Position::new().with(Axis::Z, z)
}

/// Motions so far, and the position at their end.
pub(super) struct MotionSequence {
    /// Without the axes whose position is unknown.
    pub end_position: Position,
    pub motions: Vec<Motion>,
    /// Feed of guarded moves, mm/min.
    near_part_feed_mm_min: f64,
}

impl MotionSequence {
    /// Adds a rapid of the axes that are not at their target yet; none if all are.
    pub fn add_rapid(&mut self, to: &Position) {
        self.add_motion(to, |to| Motion::Rapid { to });
    }

    /// Adds motions in this order: rotary axes, spindle orientation, X and Y as in `to`, and last Z to `z`.
    pub fn add_rapids_across_and_down(&mut self, to: &Position, z: f64) {
        self.add_rapid(&to.filter_axes(|axis| !axis.is_linear() && axis != Axis::S));
        self.add_spindle_orientation(to.get(Axis::S));
        self.add_rapid(&to.filter_axes(|axis| matches!(axis, Axis::X | Axis::Y)));
        self.add_rapid(&z_position(z));
    }

    /// Adds a guarded move at the feed near the part, of the axes that are not at their target yet; none if all are.
    pub fn add_guarded_move(&mut self, to: &Position) {
        let feed_mm_min = self.near_part_feed_mm_min;
        self.add_motion(to, |to| Motion::Guarded { to, feed_mm_min });
    }

    /// Empty path from `position`; `None`: every axis counts as not at its target.
    pub fn starting_at(position: Option<&Position>, near_part_feed_mm_min: f64) -> Self {
        Self { end_position: position.cloned().unwrap_or_default(), motions: Vec::new(), near_part_feed_mm_min }
    }

    /// Adds a motion of the axes that are not at their target yet; none if all are.
    pub fn add_motion(&mut self, to: &Position, motion: impl FnOnce(Position) -> Motion) {
        let moved: Position = to.iter().filter(|(axis, value)| !self.is_at(*axis, *value)).collect();
        if !moved.is_empty() {
            self.end_position = self.end_position.updated_by(&moved);
            self.motions.push(motion(moved));
        }
    }

    /// Adds the orientation of the spindle to `s`, rad, if the spindle is not there.
    pub fn add_spindle_orientation(&mut self, s: Option<f64>) {
        if let Some(s) = s.filter(|s| !self.is_at(Axis::S, *s)) {
            self.end_position.set(Axis::S, s);
            self.motions.push(Motion::OrientSpindle { s });
        }
    }

    /// Whether the axis is at `value`, mm or rad, at the end of the motions; false if its position is unknown.
    pub fn is_at(&self, axis: Axis, value: f64) -> bool {
        self.end_position.get(axis).is_some_and(|at| (at - value).abs() <= EQUAL_POSITION_TOLERANCE_MM_OR_RAD)
    }
}
