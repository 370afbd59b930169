//! Positions of the axes during a motion, as the control has stamped them.

use crate::{Axis, Position};

/// Positions with their times. Between two consecutive positions, the axes were on the straight line; where the
/// control reports missing positions, the path is unknown.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct AxisTrack {
    axes: Vec<Axis>,
    /// Times on the devices' clock, s; increasing.
    times_s: Vec<f64>,
    /// The positions in sequence, flat: one value per axis for each time; mm or rad.
    flat_positions_mm_or_rad: Vec<f64>,
    /// Indices of the positions before which other positions are missing; increasing.
    indices_after_gap: Vec<usize>,
}

impl AxisTrack {
    /// Empty track of these axes.
    pub fn new(axes: Vec<Axis>) -> Self {
        Self { axes, ..Self::default() }
    }

    /// Appends a position: a value for each axis, in their order, mm or rad. A position that is not later than the
    /// last one, or that lacks a value, is dropped and counts as a gap.
    pub fn push(&mut self, t_s: f64, values: impl IntoIterator<Item = f64>) {
        if self.times_s.last().is_some_and(|last| *last >= t_s) {
            return self.record_gap();
        }
        let before = self.flat_positions_mm_or_rad.len();
        self.flat_positions_mm_or_rad.extend(values.into_iter().take(self.axes.len()));
        if self.flat_positions_mm_or_rad.len() == before + self.axes.len() {
            self.times_s.push(t_s);
        } else {
            self.flat_positions_mm_or_rad.truncate(before);
            self.record_gap();
        }
    }

    /// Records that positions are missing before the next one.
    pub fn record_gap(&mut self) {
        let next = self.times_s.len();
        if next > 0 && self.indices_after_gap.last() != Some(&next) {
            self.indices_after_gap.push(next);
        }
    }

    /// Number of positions.
    pub fn position_count(&self) -> usize {
        self.times_s.len()
    }

    /// Number of gaps between the first and the last position, each of one or more missing positions.
    pub fn gap_count(&self) -> usize {
        self.indices_after_gap.iter().filter(|gap| **gap < self.position_count()).count()
    }

    /// Position of the axes at time `t_s`, interpolated linearly; `None` before the first position, after the last,
    /// and in a gap.
    pub fn position_at(&self, t_s: f64) -> Option<Position> {
        let after = self.times_s.partition_point(|time| *time < t_s);
        let (late_s, late) = (*self.times_s.get(after)?, self.axis_values_of_position(after)?);
        if late_s == t_s {
            return Some(self.position_from_values(late.iter().copied()));
        }
        let before = after.checked_sub(1)?;
        if self.indices_after_gap.binary_search(&after).is_ok() {
            return None;
        }
        let (early_s, early) = (*self.times_s.get(before)?, self.axis_values_of_position(before)?);
        let part = (t_s - early_s) / (late_s - early_s);
        Some(self.position_from_values(early.iter().zip(late).map(|(from, to)| from + part * (to - from))))
    }

    /// Times at which the axes started and arrived, s. Start: last position before any axis first leaves the start
    /// position by more than `tolerance` (mm or rad). Arrival: first position from which on all axes stay within
    /// `tolerance` of the last position. `None` if the axes did not move.
    pub fn motion_interval_s(&self, tolerance: f64) -> Option<(f64, f64)> {
        let (first, last) =
            (self.axis_values_of_position(0)?, self.axis_values_of_position(self.position_count().checked_sub(1)?)?);
        let is_near = |number: usize, reference: &[f64]| {
            let at = self.axis_values_of_position(number).unwrap_or_default();
            at.iter().zip(reference).all(|(at, reference)| (at - reference).abs() <= tolerance)
        };
        let last_rest = (0..self.position_count()).find(|number| !is_near(*number, first))?.saturating_sub(1);
        let first_rest = (0..self.position_count()).rev().find(|number| !is_near(*number, last))? + 1;
        Some((*self.times_s.get(last_rest)?, *self.times_s.get(first_rest)?))
    }

    /// Number of `points` that the track reaches in sequence, each within `tolerance` (mm or rad) on every axis that
    /// the point contains. One position of the track reaches at most one point.
    pub fn reached_point_count(&self, points: &[Position], tolerance: f64) -> usize {
        let mut reached = 0;
        for values in self.flat_positions_mm_or_rad.chunks_exact(self.axes.len().max(1)) {
            let is_near = |point: &Position| {
                let coordinates = self.axes.iter().zip(values);
                let off = |(axis, at): (&Axis, &f64)| Some((point.get(*axis)? - at).abs());
                coordinates.filter_map(off).all(|off| off <= tolerance)
            };
            reached += usize::from(points.get(reached).is_some_and(is_near));
        }
        reached
    }

    fn axis_values_of_position(&self, position_index: usize) -> Option<&[f64]> {
        self.flat_positions_mm_or_rad.chunks_exact(self.axes.len().max(1)).nth(position_index)
    }

    fn position_from_values(&self, values: impl Iterator<Item = f64>) -> Position {
        self.axes.iter().copied().zip(values).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One axis: 0 at 10 s, 1 at 11 s, then a gap, 4 at 14 s, 4 at 15 s.
    fn track_with_gap() -> AxisTrack {
        let mut track = AxisTrack::new(vec![Axis::Y]);
        track.record_gap();
        for (t_s, y) in [(10.0, 0.0), (11.0, 1.0)] {
            track.push(t_s, [y]);
        }
        track.record_gap();
        track.record_gap();
        for (t_s, y) in [(14.0, 4.0), (15.0, 4.0)] {
            track.push(t_s, [y]);
        }
        track
    }

    #[test]
    fn positions_are_interpolated_except_in_gaps() {
        let y = |t_s: f64| track_with_gap().position_at(t_s).map(|at| at.get_or_zero(Axis::Y));
        assert_eq!(y(10.25), Some(0.25));
        assert_eq!((y(10.0), y(11.0), y(14.0), y(15.0)), (Some(0.0), Some(1.0), Some(4.0), Some(4.0)));
        for t_s in [9.999, 11.001, 12.5, 13.999, 15.001, f64::NAN] {
            assert_eq!(y(t_s), None, "{t_s}");
        }
        assert_eq!((track_with_gap().position_count(), track_with_gap().gap_count()), (4, 1));
        assert_eq!(AxisTrack::default().position_at(1.0), None);
    }

    #[test]
    fn out_of_order_or_incomplete_positions_are_gaps() {
        let mut back = AxisTrack::new(vec![Axis::X, Axis::Y]);
        for (t_s, values) in [(1.0, &[1.0, 1.0][..]), (0.5, &[9.0, 9.0]), (2.0, &[2.0, 2.0])] {
            back.push(t_s, values.iter().copied());
        }
        assert_eq!((back.position_count(), back.position_at(1.5)), (2, None));
        back.push(3.0, [3.0]);
        back.push(4.0, [4.0, 4.0]);
        assert_eq!((back.position_count(), back.position_at(3.5), back.gap_count()), (3, None, 2));
    }

    #[test]
    fn reached_points_are_counted_in_order() {
        let at = |y: f64| Position::new().with(Axis::Y, y).with(Axis::X, 9.0);
        let reaches = |points: &[f64]| {
            let points: Vec<Position> = points.iter().map(|y| at(*y)).collect();
            track_with_gap().reached_point_count(&points, 0.1)
        };
        assert_eq!(reaches(&[0.0, 1.05, 3.95]), 3);
        assert_eq!((reaches(&[0.0, 2.0, 4.0]), reaches(&[1.0, 0.0]), reaches(&[0.5])), (1, 1, 0));
        assert_eq!(AxisTrack::default().reached_point_count(&[at(0.0)], 0.1), 0);
    }

    #[test]
    fn the_motion_interval_is_between_start_and_arrival() {
        let mut track = AxisTrack::new(vec![Axis::X]);
        for (t_s, x) in [(0.0, 5.0), (1.0, 5.001), (2.0, 6.0), (3.0, 4.0), (4.0, 5.0), (5.0, 5.001)] {
            track.push(t_s, [x]);
        }
        assert_eq!(track.motion_interval_s(0.01), Some((1.0, 4.0)));
        assert_eq!(track.motion_interval_s(10.0), None);
        assert_eq!(AxisTrack::default().motion_interval_s(0.01), None);
    }
}
