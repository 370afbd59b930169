//! Machine time: trapezoidal speed profile along each straight motion.

use super::target;
use machine::record::machine::Machine;
use machine::record::motion::{Block, Motion};
use machine::{Axis, Position};

/// Machine time by kind of motion, s.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct MachineTime {
    /// Touches: to contact and back.
    pub touch_s: f64,
    /// Moves of X, Y, Z alone.
    pub way_s: f64,
    /// Moves in which a rotary axis or the spindle turns.
    pub rotary_s: f64,
    /// Dwells.
    pub rest_s: f64,
}

impl MachineTime {
    /// Machine time of the blocks in their order; the move to the first position is not included.
    pub fn of(blocks: &[Block], machine: &Machine) -> Self {
        let (mut time, mut stands) = (Self::default(), Position::new());
        for block in blocks {
            time.add(block, &mut stands, machine);
        }
        time
    }

    pub fn total_s(&self) -> f64 {
        self.touch_s + self.way_s + self.rotary_s + self.rest_s
    }

    fn add(&mut self, block: &Block, stands: &mut Position, machine: &Machine) {
        for motion in &block.motions {
            let Some(to) = target(motion) else {
                if let Motion::Dwell { seconds } = motion {
                    self.rest_s += seconds;
                }
                continue;
            };
            let (to, feed) = match motion {
                Motion::Probe { feed_mm_min, .. } => (middle(stands, &to), Some(*feed_mm_min)),
                Motion::Guarded { feed_mm_min, .. }
                | Motion::BackOff { feed_mm_min, .. }
                | Motion::Feed { feed_mm_min, .. } => (to, Some(*feed_mm_min)),
                _ => (to, None),
            };
            let turns = |(axis, end): (Axis, f64)| {
                !axis.is_linear() && stands.get(axis).is_some_and(|from| from != end)
            };
            let spent = match motion {
                Motion::Probe { .. } | Motion::BackOff { .. } => &mut self.touch_s,
                _ if to.iter().any(turns) => &mut self.rotary_s,
                _ => &mut self.way_s,
            };
            *spent += motion_s(stands, &to, feed, machine);
            *stands = stands.updated_by(&to);
        }
    }
}

/// Time of `block` from `begins`, s, every motion from rest to rest. The axes move together within the rapid speed
/// and acceleration of each. A feed applies to the path in X, Y, Z, or to the rotary axes in degrees if they alone
/// move. The point of contact is unknown: the middle of the touch is assumed. An axis that `begins` does not
/// contain takes no time for its first move.
pub fn machine_time_s(block: &Block, begins: &Position, machine: &Machine) -> f64 {
    let mut time = MachineTime::default();
    time.add(block, &mut begins.clone(), machine);
    time.total_s()
}

fn middle(from: &Position, to: &Position) -> Position {
    to.iter().map(|(axis, end)| (axis, (from.get(axis).unwrap_or(end) + end) / 2.0)).collect()
}

pub(super) fn motion_s(
    from: &Position,
    to: &Position,
    feed_per_min: Option<f64>,
    machine: &Machine,
) -> f64 {
    let ways: Vec<(Axis, f64)> = to
        .iter()
        .map(|(axis, end)| (axis, (end - from.get(axis).unwrap_or(end)).abs()))
        .filter(|(_, way)| *way > 0.0)
        .collect();
    if ways.is_empty() {
        return 0.0;
    }
    // Speed and acceleration in shares of the whole path: the slowest axis limits them.
    let (mut speed, mut acceleration) = (f64::INFINITY, f64::INFINITY);
    for (axis, way) in &ways {
        if let Some(spec) = machine.axes.get(axis) {
            speed = speed.min(axis.from_edge(spec.rapid_per_min) / 60.0 / way);
            acceleration = acceleration.min(axis.from_edge(spec.acceleration_per_s2) / way);
        }
    }
    if let Some(feed) = feed_per_min {
        speed = speed.min(feed / 60.0 / feed_length(&ways));
    }
    trapezoid_s(speed, acceleration)
}

/// Length to which the feed applies: mm in X, Y, Z; degrees if only rotary axes move.
fn feed_length(ways: &[(Axis, f64)]) -> f64 {
    let norm = |linear: bool| {
        ways.iter()
            .filter(|(axis, _)| axis.is_linear() == linear)
            .map(|(axis, way)| axis.to_edge(*way).powi(2))
            .sum::<f64>()
            .sqrt()
    };
    if norm(true) > 0.0 { norm(true) } else { norm(false) }
}

/// Time for the distance 1, from rest to rest.
fn trapezoid_s(speed: f64, acceleration: f64) -> f64 {
    if speed * speed < acceleration {
        1.0 / speed + speed / acceleration
    } else {
        2.0 / acceleration.sqrt()
    }
}
