//! One straight move of several axes at once, and the lost motion of the linear axes.

use std::collections::BTreeMap;

use super::velocity_profile::{Speed, VelocityProfile};
use machine::record::machine::StatedAxis;
use machine::{Axis, Position};

/// Speed and acceleration of spindle orientation, deg/min and deg/s²; machine files seldom state them.
const SPINDLE_ORIENTATION_SPEED_DEG_MIN: f64 = 10_000.0;
const SPINDLE_ORIENTATION_ACCELERATION_DEG_S2: f64 = 1_000.0;

/// Lost motion: after a reversal, a linear axis moves only once its command has passed the whole gap, so that the axis
/// lags behind its command by half the gap.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LostMotion {
    /// Half of the whole gap of each axis with lost motion.
    half_backlash_mm: BTreeMap<Axis, f64>,
    /// True axis positions after the last move, lost motion included.
    actual_position: Position,
}

impl LostMotion {
    /// `backlash_um`: whole gap of each axis. At `command`, each axis is in the middle of its gap.
    pub fn new(backlash_um: &BTreeMap<Axis, f64>, command: &Position) -> Self {
        let half_backlash_mm =
            backlash_um.iter().filter(|(axis, _)| axis.is_linear()).map(|(axis, gap)| (*axis, gap * 0.5e-3)).collect();
        Self { half_backlash_mm, actual_position: command.clone() }
    }

    /// True axis positions, lost motion included, after a move to `command` without a reversal on the way.
    pub fn position_after_move_to(&self, command: &Position) -> Position {
        let mut axes = command.clone();
        for (axis, half) in &self.half_backlash_mm {
            let command = command.get_or_zero(*axis);
            axes.set(*axis, self.actual_position.get_or_zero(*axis).clamp(command - half, command + half));
        }
        axes
    }

    /// Stores the true axis positions after a move to `command` without a reversal.
    pub fn update_actual_position(&mut self, command: &Position) {
        self.actual_position = self.position_after_move_to(command);
    }
}

/// Bounds of a move: the speeds of the axes, and the largest distance of the stylus ball from a rotary axis.
pub(super) struct MoveBounds<'a> {
    pub stated_axes: &'a BTreeMap<Axis, StatedAxis>,
    /// Upper bound of the distance of the stylus ball from a rotary axis, mm, with the linear axes at a position.
    pub max_stylus_distance_from_axis: &'a dyn Fn(Axis, &Position) -> f64,
    /// Largest ratio of true to commanded travel.
    pub max_true_travel_ratio: f64,
}

/// A straight move from rest to rest; the path fraction runs from 0 (start) to 1 (target).
#[derive(Debug, Clone)]
pub(super) struct MovePath {
    /// Commanded positions of all axes at the start.
    from: Position,
    /// Signed travel of each axis that moves, mm or rad.
    travel_by_axis: Position,
    /// Target of the axes that move.
    target: Position,
    pub velocity_profile: VelocityProfile,
    /// Upper bound of the ball's travel over the whole path, mm.
    pub max_stylus_travel_mm: f64,
    /// State of the lost motion at the start.
    lost_motion: LostMotion,
}

impl MovePath {
    /// Path of a move; `None` if nothing moves.
    pub fn new(
        from: &Position,
        to: &Position,
        speed: Speed,
        lost_motion: &LostMotion,
        limits: &MoveBounds,
    ) -> Option<Self> {
        let span: Position = to
            .iter()
            .filter_map(|(axis, end)| Some((axis, end - from.get(axis)?)))
            .filter(|(_, travel)| *travel != 0.0 && travel.is_finite())
            .collect();
        if span.is_empty() {
            return None;
        }
        let ramp = velocity_profile_of_move(&span, speed, limits.stated_axes);
        let max_ball_travel_mm =
            max_stylus_travel_mm(from, &span, limits.max_stylus_distance_from_axis) * limits.max_true_travel_ratio;
        let to = to.filter_axes(|axis| span.get(axis).is_some());
        Some(Self {
            from: from.clone(),
            travel_by_axis: span,
            target: to,
            velocity_profile: ramp,
            max_stylus_travel_mm: max_ball_travel_mm,
            lost_motion: lost_motion.clone(),
        })
    }

    /// Commanded position at the path fraction; exactly the target at the end.
    pub fn command_at_fraction(&self, fraction: f64) -> Position {
        let mut at = self.from.clone();
        if fraction >= 1.0 {
            return at.updated_by(&self.target);
        }
        for (axis, travel) in self.travel_by_axis.iter() {
            at.set(axis, self.from.get_or_zero(axis) + travel * fraction);
        }
        at
    }

    /// True axis positions at the path fraction.
    pub fn true_axes_at_fraction(&self, fraction: f64) -> Position {
        self.lost_motion.position_after_move_to(&self.command_at_fraction(fraction))
    }
}

/// Velocity profile of a move, limited by its slowest axis. A feed is the speed along the path of the linear axes, as
/// in RS274/NGC; if only rotary axes move, it is in degrees per minute.
fn velocity_profile_of_move(span: &Position, speed: Speed, axes: &BTreeMap<Axis, StatedAxis>) -> VelocityProfile {
    let (mut fastest, mut acceleration) = (f64::INFINITY, f64::INFINITY);
    for (axis, travel) in span.iter() {
        let (rapid, accelerate) = axes
            .get(&axis)
            .map_or((SPINDLE_ORIENTATION_SPEED_DEG_MIN, SPINDLE_ORIENTATION_ACCELERATION_DEG_S2), |spec| {
                (spec.rapid_per_min, spec.acceleration_per_s2)
            });
        fastest = fastest.min(axis.to_mm_or_rad(rapid) / 60.0 / travel.abs());
        acceleration = acceleration.min(axis.to_mm_or_rad(accelerate) / travel.abs());
    }
    if let Speed::Feed { mm_min } = speed {
        // A feed of zero would never reach the target.
        fastest = fastest.min(mm_min.max(1e-3) / 60.0 / feed_path_length(span));
    }
    VelocityProfile::new(fastest, acceleration)
}

/// Length of the path of the linear axes, mm; if only rotary axes move, of their path, degrees.
fn feed_path_length(span: &Position) -> f64 {
    let length = |linear: bool| {
        let parts = span.iter().filter(|(axis, _)| axis.is_linear() == linear);
        parts.map(|(axis, travel)| axis.to_mm_or_deg(travel).powi(2)).sum::<f64>().sqrt()
    };
    let linear = length(true);
    if linear > 0.0 { linear } else { length(false) }
}

/// Upper bound of the travel of the stylus ball, for true axes that move as commanded.
fn max_stylus_travel_mm(from: &Position, span: &Position, lever_arm: &dyn Fn(Axis, &Position) -> f64) -> f64 {
    let linear: f64 = span.iter().filter(|(a, _)| a.is_linear()).map(|(_, t)| t * t).sum::<f64>().sqrt();
    let turns: f64 = span
        .iter()
        .filter(|(axis, _)| !axis.is_linear())
        .map(|(axis, travel)| travel.abs() * (lever_arm(axis, from) + linear))
        .sum();
    // 1 % above the nominal travel leaves room for all errors.
    (linear + turns) * 1.01
}
