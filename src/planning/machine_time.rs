//! Machine time: trapezoidal speed profile along each straight motion.

use super::motion_target;
use machine::record::machine::Machine;
use machine::record::motion::{Motion, MotionBlock};
use machine::{Axis, Position};

/// Machine time by kind of motion, s.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct MachineTime {
    /// Touches, only to the assumed contact at the middle of each touch, and the back-offs.
    pub touch_s: f64,
    /// Moves of X, Y, Z alone, without touches.
    pub linear_move_s: f64,
    /// Moves in which a rotary axis or the spindle turns.
    pub rotary_move_s: f64,
    /// Dwells.
    pub dwell_s: f64,
}

impl MachineTime {
    /// Machine time of the blocks in their order; the move to the first position is not included.
    pub fn from_blocks(blocks: &[MotionBlock], machine: &Machine) -> Self {
        let (mut time, mut position) = (Self::default(), Position::new());
        for block in blocks {
            time.add_block(block, &mut position, machine);
        }
        time
    }

    pub fn total_s(&self) -> f64 {
        self.touch_s + self.linear_move_s + self.rotary_move_s + self.dwell_s
    }

    /// Adds the times of the motions of `block`, and moves `position` to their end; a touch ends at its middle.
    fn add_block(&mut self, block: &MotionBlock, position: &mut Position, machine: &Machine) {
        for motion in &block.motions {
            let Some(to) = motion_target(motion) else {
                if let Motion::Dwell { seconds } = motion {
                    self.dwell_s += seconds;
                }
                continue;
            };
            let (to, feed) = match motion {
                Motion::Probe { feed_mm_min, .. } => (midpoint(position, &to), Some(*feed_mm_min)),
                Motion::Guarded { feed_mm_min, .. }
                | Motion::BackOff { feed_mm_min, .. }
                | Motion::Feed { feed_mm_min, .. } => (to, Some(*feed_mm_min)),
                _ => (to, None),
            };
            let turns =
                |(axis, end): (Axis, f64)| !axis.is_linear() && position.get(axis).is_some_and(|from| from != end);
            let spent = match motion {
                Motion::Probe { .. } | Motion::BackOff { .. } => &mut self.touch_s,
                _ if to.iter().any(turns) => &mut self.rotary_move_s,
                _ => &mut self.linear_move_s,
            };
            *spent += motion_time_s(position, &to, feed, machine);
            *position = position.updated_by(&to);
        }
    }
}

/// Time of `block` from `start_position`, s, every motion from rest to rest. The axes move together within the rapid
/// speed and acceleration of each. A feed applies to the path in X, Y, Z, or to the rotary axes in degrees if they
/// alone move. The point of contact is unknown: the middle of the touch is assumed. An axis that `start_position` does
/// not contain takes no time for its first move.
pub fn machine_time_s(block: &MotionBlock, start_position: &Position, machine: &Machine) -> f64 {
    let mut time = MachineTime::default();
    time.add_block(block, &mut start_position.clone(), machine);
    time.total_s()
}

/// Middle between `from` and `to` for the axes of `to`; an axis that `from` does not contain is at its end.
fn midpoint(from: &Position, to: &Position) -> Position {
    to.iter().map(|(axis, end)| (axis, (from.get(axis).unwrap_or(end) + end) / 2.0)).collect()
}

/// Time of one straight motion from rest to rest, s. `feed_per_min`: mm/min, or degrees/min if only rotary axes move;
/// `None`: rapid. An axis that `from` does not contain takes no time.
pub(super) fn motion_time_s(from: &Position, to: &Position, feed_per_min: Option<f64>, machine: &Machine) -> f64 {
    let axis_distances: Vec<(Axis, f64)> = to
        .iter()
        .map(|(axis, end)| (axis, (end - from.get(axis).unwrap_or(end)).abs()))
        .filter(|(_, distance)| *distance > 0.0)
        .collect();
    if axis_distances.is_empty() {
        return 0.0;
    }
    // Speed and acceleration as fractions of the whole path per s and per s²; the slowest axis limits them.
    let (mut speed, mut acceleration) = (f64::INFINITY, f64::INFINITY);
    for (axis, distance) in &axis_distances {
        if let Some(spec) = machine.axes.get(axis) {
            speed = speed.min(axis.to_mm_or_rad(spec.rapid_per_min) / 60.0 / distance);
            acceleration = acceleration.min(axis.to_mm_or_rad(spec.acceleration_per_s2) / distance);
        }
    }
    if let Some(feed) = feed_per_min {
        speed = speed.min(feed / 60.0 / feed_path_length_mm_or_deg(&axis_distances));
    }
    trapezoid_time_of_unit_distance_s(speed, acceleration)
}

/// Length to which the feed applies: mm in X, Y, Z; degrees if only rotary axes move.
fn feed_path_length_mm_or_deg(axis_distances: &[(Axis, f64)]) -> f64 {
    let norm = |linear: bool| {
        axis_distances
            .iter()
            .filter(|(axis, _)| axis.is_linear() == linear)
            .map(|(axis, distance)| axis.to_mm_or_deg(*distance).powi(2))
            .sum::<f64>()
            .sqrt()
    };
    if norm(true) > 0.0 { norm(true) } else { norm(false) }
}

/// Time of a move over the distance 1 from rest to rest, s; `speed` per s and `acceleration` per s² of this distance.
fn trapezoid_time_of_unit_distance_s(speed: f64, acceleration: f64) -> f64 {
    if speed * speed < acceleration { 1.0 / speed + speed / acceleration } else { 2.0 / acceleration.sqrt() }
}
