//! Positions of the axes during a motion, as the control has stamped them.

use crate::{Axis, Position};

/// Positions with their times. Between two consecutive positions, the axes were on the straight line; where the
/// control reports missing positions, the path is unknown.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Track {
    axes: Vec<Axis>,
    /// Times on the devices' clock, s; increasing.
    times_s: Vec<f64>,
    /// The positions in sequence, each with one value per axis; mm or rad.
    values: Vec<f64>,
    /// Indices of the positions before which some are missing; increasing.
    gaps: Vec<usize>,
}

impl Track {
    /// Empty track of these axes.
    pub fn of(axes: Vec<Axis>) -> Self {
        Self { axes, ..Self::default() }
    }

    /// Appends a position: a value for each axis, in their order, mm or rad. A position that is not later than the
    /// last one is dropped.
    pub fn push(&mut self, t_s: f64, values: impl IntoIterator<Item = f64>) {
        if self.times_s.last().is_some_and(|last| *last >= t_s) {
            return self.gap();
        }
        let before = self.values.len();
        self.values.extend(values.into_iter().take(self.axes.len()));
        if self.values.len() == before + self.axes.len() {
            self.times_s.push(t_s);
        } else {
            self.values.truncate(before);
            self.gap();
        }
    }

    /// Records that positions are missing before the next one.
    pub fn gap(&mut self) {
        let next = self.times_s.len();
        if next > 0 && self.gaps.last() != Some(&next) {
            self.gaps.push(next);
        }
    }

    /// Number of positions.
    pub fn positions(&self) -> usize {
        self.times_s.len()
    }

    /// Number of gaps between the first and the last position.
    pub fn gaps(&self) -> usize {
        self.gaps.iter().filter(|gap| **gap < self.positions()).count()
    }

    /// Position of the axes at time `t_s`; `None` before the first position, after the last, and in a gap.
    pub fn at(&self, t_s: f64) -> Option<Position> {
        let after = self.times_s.partition_point(|time| *time < t_s);
        let (late_s, late) = (*self.times_s.get(after)?, self.number(after)?);
        if late_s == t_s {
            return Some(self.position(late.iter().copied()));
        }
        let before = after.checked_sub(1)?;
        if self.gaps.binary_search(&after).is_ok() {
            return None;
        }
        let (early_s, early) = (*self.times_s.get(before)?, self.number(before)?);
        let part = (t_s - early_s) / (late_s - early_s);
        Some(self.position(early.iter().zip(late).map(|(from, to)| from + part * (to - from))))
    }

    /// Times at which the axes started and arrived: of the last position within `still` (mm or rad) of the first
    /// one, and of the first position that is as near to the last one. `None` if the axes did not move.
    pub fn moving_s(&self, still: f64) -> Option<(f64, f64)> {
        let (first, last) = (self.number(0)?, self.number(self.positions().checked_sub(1)?)?);
        let near = |number: usize, stands: &[f64]| {
            let at = self.number(number).unwrap_or_default();
            at.iter().zip(stands).all(|(at, stands)| (at - stands).abs() <= still)
        };
        let set_out = (0..self.positions()).find(|number| !near(*number, first))?.saturating_sub(1);
        let stands_from = (0..self.positions()).rev().find(|number| !near(*number, last))? + 1;
        Some((*self.times_s.get(set_out)?, *self.times_s.get(stands_from)?))
    }

    /// Number of `points` that the track reaches in sequence, each within `near` (mm or rad).
    pub fn reaches(&self, points: &[Position], near: f64) -> usize {
        let mut reached = 0;
        for values in self.values.chunks_exact(self.axes.len().max(1)) {
            let is_near = |point: &Position| {
                let stands = self.axes.iter().zip(values);
                let off = |(axis, at): (&Axis, &f64)| Some((point.get(*axis)? - at).abs());
                stands.filter_map(off).all(|off| off <= near)
            };
            reached += usize::from(points.get(reached).is_some_and(is_near));
        }
        reached
    }

    fn number(&self, number: usize) -> Option<&[f64]> {
        self.values.chunks_exact(self.axes.len().max(1)).nth(number)
    }

    fn position(&self, values: impl Iterator<Item = f64>) -> Position {
        self.axes.iter().copied().zip(values).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One axis: 0 at 10 s, 1 at 11 s, then a gap, 4 at 14 s, 4 at 15 s.
    fn track() -> Track {
        let mut track = Track::of(vec![Axis::Y]);
        track.gap();
        for (t_s, y) in [(10.0, 0.0), (11.0, 1.0)] {
            track.push(t_s, [y]);
        }
        track.gap();
        track.gap();
        for (t_s, y) in [(14.0, 4.0), (15.0, 4.0)] {
            track.push(t_s, [y]);
        }
        track
    }

    #[test]
    fn between_two_positions_lies_the_straight_line_and_in_a_gap_nothing() {
        let y = |t_s: f64| track().at(t_s).map(|at| at.at(Axis::Y));
        assert_eq!(y(10.25), Some(0.25));
        assert_eq!(
            (y(10.0), y(11.0), y(14.0), y(15.0)),
            (Some(0.0), Some(1.0), Some(4.0), Some(4.0))
        );
        for t_s in [9.999, 11.001, 12.5, 13.999, 15.001, f64::NAN] {
            assert_eq!(y(t_s), None, "{t_s}");
        }
        assert_eq!((track().positions(), track().gaps()), (4, 1));
        assert_eq!(Track::default().at(1.0), None);
    }

    #[test]
    fn what_is_out_of_order_or_incomplete_is_a_gap() {
        let mut back = Track::of(vec![Axis::X, Axis::Y]);
        for (t_s, values) in [(1.0, &[1.0, 1.0][..]), (0.5, &[9.0, 9.0]), (2.0, &[2.0, 2.0])] {
            back.push(t_s, values.iter().copied());
        }
        assert_eq!((back.positions(), back.at(1.5)), (2, None));
        back.push(3.0, [3.0]);
        back.push(4.0, [4.0, 4.0]);
        assert_eq!((back.positions(), back.at(3.5), back.gaps()), (3, None, 2));
    }

    #[test]
    fn it_knows_which_points_it_has_passed_in_their_order() {
        let at = |y: f64| Position::new().with(Axis::Y, y).with(Axis::X, 9.0);
        let reaches = |points: &[f64]| {
            let points: Vec<Position> = points.iter().map(|y| at(*y)).collect();
            track().reaches(&points, 0.1)
        };
        assert_eq!(reaches(&[0.0, 1.05, 3.95]), 3);
        assert_eq!((reaches(&[0.0, 2.0, 4.0]), reaches(&[1.0, 0.0]), reaches(&[0.5])), (1, 1, 0));
        assert_eq!(Track::default().reaches(&[at(0.0)], 0.1), 0);
    }

    #[test]
    fn it_knows_when_the_axes_moved() {
        let mut track = Track::of(vec![Axis::X]);
        for (t_s, x) in [(0.0, 5.0), (1.0, 5.001), (2.0, 6.0), (3.0, 4.0), (4.0, 5.0), (5.0, 5.001)]
        {
            track.push(t_s, [x]);
        }
        assert_eq!(track.moving_s(0.01), Some((1.0, 4.0)));
        assert_eq!(track.moving_s(10.0), None);
        assert_eq!(Track::default().moving_s(0.01), None);
    }
}
