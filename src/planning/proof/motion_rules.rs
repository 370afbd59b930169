//! Rules for a single motion: limits, feeds, lengths, start and end positions.

use std::f64::consts::{PI, TAU};

use super::refusal::{PositionMismatch, RefusalReason};
use crate::gcode::Dialect;
use crate::gcode::rs274::{MotionKind, ReadMotion};
use machine::kinematics::AxisCommands;
use machine::record::machine::{Machine, Probe};
use machine::{Axis, Position};

/// Rounding tolerance of feeds, which have three decimals, mm/min.
const FEED_TOLERANCE_MM_MIN: f64 = 0.000_501;
/// Tolerance of the length of a touch, because its end points are rounded, mm.
const TOUCH_LENGTH_TOLERANCE_MM: f64 = 1e-3;

type CheckResult = Result<(), RefusalReason>;

/// Checks that the machine has every axis of the motion and that each target is within the limits. The spindle is
/// oriented modulo one turn: its position is accepted if it is within the limits after adding or subtracting a full
/// turn.
pub fn check_axis_limits(motion: &ReadMotion, machine: &Machine, dialect: &Dialect) -> CheckResult {
    let spindle = match motion.kind {
        MotionKind::OrientSpindle { s } => Position::new().with(Axis::S, s),
        _ => Position::new(),
    };
    for (axis, value) in motion.target.updated_by(&spindle).iter() {
        let spec = machine.axes.get(&axis).ok_or(RefusalReason::UnknownAxis(axis))?;
        let slack = dialect.position_rounding_tolerance(axis);
        let within =
            |value: f64| (axis.to_mm_or_rad(spec.min) - slack..=axis.to_mm_or_rad(spec.max) + slack).contains(&value);
        let turns: &[f64] = if axis == Axis::S { &[0.0, -TAU, TAU] } else { &[0.0] };
        if !turns.iter().any(|turn| within(value + turn)) {
            let (value, min, max) = (axis.to_mm_or_deg(value), spec.min, spec.max);
            return Err(RefusalReason::OutsideLimits { axis, value, min, max });
        }
    }
    Ok(())
}

pub fn check_exact_feed(motion_name: &'static str, motion: &ReadMotion, expected: f64) -> CheckResult {
    let feed = motion.feed_mm_min.unwrap_or(f64::NAN);
    if (feed - expected).abs() <= FEED_TOLERANCE_MM_MIN {
        return Ok(());
    }
    Err(RefusalReason::WrongFeed { motion_name, feed, limit: expected.to_string() })
}

pub fn check_max_feed(motion_name: &'static str, motion: &ReadMotion, max_feed: f64) -> CheckResult {
    let feed = motion.feed_mm_min.unwrap_or(f64::NAN);
    if feed <= max_feed + FEED_TOLERANCE_MM_MIN {
        return Ok(());
    }
    Err(RefusalReason::WrongFeed { motion_name, feed, limit: format!("at most {max_feed}") })
}

/// Braking distance from the feed at the smallest acceleration of the linear axes, mm.
///
/// # Errors
/// The braking distance is longer than the probe's overtravel.
pub fn braking_distance_within_overtravel_mm(
    motion: &ReadMotion,
    machine: &Machine,
    probe: &Probe,
) -> Result<f64, RefusalReason> {
    let feed = motion.feed_mm_min.unwrap_or(f64::NAN);
    let distance_mm = (feed / 60.0).powi(2) / (2.0 * machine.min_linear_acceleration_mm_s2());
    let overtravel = probe.overtravel_mm;
    if distance_mm <= overtravel {
        Ok(distance_mm)
    } else {
        Err(RefusalReason::BrakingDistanceTooLong { feed, distance_mm, overtravel })
    }
}

pub fn check_touch_length(from: &Position, to: &Position, overtravel: f64) -> CheckResult {
    let square = |axis: Axis| (to.get_or_zero(axis) - from.get_or_zero(axis)).powi(2);
    let length = Axis::LINEAR.into_iter().map(square).sum::<f64>().sqrt();
    if length <= overtravel + TOUCH_LENGTH_TOLERANCE_MM {
        return Ok(());
    }
    Err(RefusalReason::TouchTooLong { length, overtravel })
}

/// Commands of all axes; a spindle that is not oriented counts as zero. `Err`: the position of another axis of the
/// machine is unknown.
pub fn axis_commands(machine: &Machine, position: &Position) -> Result<AxisCommands, RefusalReason> {
    let mut axes = machine.axes.keys();
    match axes.find(|axis| **axis != Axis::S && position.get(**axis).is_none()) {
        Some(axis) => Err(RefusalReason::UnknownAxisPosition(*axis)),
        None => Ok(Axis::ALL.map(|axis| position.get_or_zero(axis))),
    }
}

/// An axis that is not at its intended position.
pub struct AxisMismatch {
    axis: Axis,
    /// Present position, mm or rad; `None`: unknown.
    actual_mm_or_rad: Option<f64>,
    /// Intended position, mm or rad.
    expected_mm_or_rad: f64,
}

impl AxisMismatch {
    /// Calls `reason` with the mismatch; if the position is unknown, returns `UnknownAxisPosition` instead.
    pub fn into_refusal_reason(self, reason: impl FnOnce(PositionMismatch) -> RefusalReason) -> RefusalReason {
        let Self { axis, actual_mm_or_rad, expected_mm_or_rad } = self;
        let Some(actual_mm_or_rad) = actual_mm_or_rad else { return RefusalReason::UnknownAxisPosition(axis) };
        let [actual, expected] = [actual_mm_or_rad, expected_mm_or_rad].map(|value| axis.to_mm_or_deg(value));
        reason(PositionMismatch { axis, actual, expected })
    }
}

/// The first axis of `expected` that is at another position, beyond rounding, or whose position is unknown. The spindle
/// is compared modulo one turn.
pub fn find_axis_mismatch(position: &Position, expected: &Position, dialect: &Dialect) -> Option<AxisMismatch> {
    expected.iter().find_map(|(axis, expected)| {
        let Some(actual) = position.get(axis) else {
            return Some(AxisMismatch { axis, actual_mm_or_rad: None, expected_mm_or_rad: expected });
        };
        let off = match axis {
            Axis::S => (actual - expected + PI).rem_euclid(TAU) - PI,
            _ => actual - expected,
        };
        let same = off.abs() <= dialect.position_rounding_tolerance(axis);
        (!same).then_some(AxisMismatch { axis, actual_mm_or_rad: Some(actual), expected_mm_or_rad: expected })
    })
}
