//! Motions of a block during planning.

use machine::record::motion::Motion;
use machine::{Axis, Position};

/// Maximum difference of equal positions, mm or rad.
pub(super) const SAME: f64 = 1e-9;

pub(super) fn height(z: f64) -> Position {
    Position::new().with(Axis::Z, z)
}

/// Motions so far, and the position at their end.
pub(super) struct Path {
    pub stands: Position,
    pub motions: Vec<Motion>,
    /// Feed of guarded moves, mm/min.
    near_feed: f64,
}

impl Path {
    pub fn rapid(&mut self, to: &Position) {
        self.feed(to, |to| Motion::Rapid { to });
    }

    pub fn guarded(&mut self, to: &Position) {
        let feed_mm_min = self.near_feed;
        self.feed(to, |to| Motion::Guarded { to, feed_mm_min });
    }

    /// Empty path from the position `stands`.
    pub fn from(stands: Option<&Position>, near_feed: f64) -> Self {
        Self { stands: stands.cloned().unwrap_or_default(), motions: Vec::new(), near_feed }
    }

    /// Adds a motion of the axes that are not at their target yet; none if all are.
    pub fn feed(&mut self, to: &Position, motion: impl FnOnce(Position) -> Motion) {
        let moved: Position =
            to.iter().filter(|(axis, value)| !self.stands_at(*axis, *value)).collect();
        if !moved.is_empty() {
            self.stands = self.stands.updated_by(&moved);
            self.motions.push(motion(moved));
        }
    }

    pub fn orient(&mut self, s: Option<f64>) {
        if let Some(s) = s.filter(|s| !self.stands_at(Axis::S, *s)) {
            self.stands.set(Axis::S, s);
            self.motions.push(Motion::Orient { s });
        }
    }

    pub fn stands_at(&self, axis: Axis, value: f64) -> bool {
        self.stands.get(axis).is_some_and(|at| (at - value).abs() <= SAME)
    }
}
