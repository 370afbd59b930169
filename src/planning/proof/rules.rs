//! Rules for a single motion: limits, feeds, lengths, start and end positions.

use std::f64::consts::{PI, TAU};

use super::refusal::{Place, Reason};
use crate::gcode::Dialect;
use crate::gcode::rs274::{Kind, ReadMotion};
use machine::record::machine::{Machine, Probe};
use machine::{Axis, Position};

/// Rounding tolerance of feeds, which have three decimals, mm/min.
const FEED_ROUNDING: f64 = 0.000_501;
/// Tolerance of the length of a touch, because its end points are rounded, mm.
const LENGTH_ROUNDING: f64 = 1e-3;

type Checked = Result<(), Reason>;

/// Checks that the machine has every axis and that each is within its limits. The spindle is oriented modulo one
/// turn: its position is accepted if it is within the limits after adding or subtracting a full turn.
pub fn limits(motion: &ReadMotion, machine: &Machine, dialect: &Dialect) -> Checked {
    let spindle = match motion.kind {
        Kind::Orient { s } => Position::new().with(Axis::S, s),
        _ => Position::new(),
    };
    for (axis, value) in motion.target.updated_by(&spindle).iter() {
        let spec = machine.axes.get(&axis).ok_or(Reason::NoAxis(axis))?;
        let slack = dialect.rounding(axis);
        let within = |value: f64| {
            (axis.from_edge(spec.min) - slack..=axis.from_edge(spec.max) + slack).contains(&value)
        };
        let turns: &[f64] = if axis == Axis::S { &[0.0, -TAU, TAU] } else { &[0.0] };
        if !turns.iter().any(|turn| within(value + turn)) {
            let (value, min, max) = (axis.to_edge(value), spec.min, spec.max);
            return Err(Reason::Limit { axis, value, min, max });
        }
    }
    Ok(())
}

pub fn feed_is(what: &'static str, motion: &ReadMotion, meant: f64) -> Checked {
    let feed = motion.feed_mm_min.unwrap_or(f64::NAN);
    if (feed - meant).abs() <= FEED_ROUNDING {
        return Ok(());
    }
    Err(Reason::Feed { what, feed, limit: meant.to_string() })
}

pub fn feed_at_most(what: &'static str, motion: &ReadMotion, most: f64) -> Checked {
    let feed = motion.feed_mm_min.unwrap_or(f64::NAN);
    if feed <= most + FEED_ROUNDING {
        return Ok(());
    }
    Err(Reason::Feed { what, feed, limit: format!("at most {most}") })
}

/// Braking distance from the feed, mm, for every linear axis; it must be within the probe's overtravel.
pub fn braking(motion: &ReadMotion, machine: &Machine, probe: &Probe) -> Result<f64, Reason> {
    let feed = motion.feed_mm_min.unwrap_or(f64::NAN);
    let axes = machine.axes.iter().filter(|(axis, _)| axis.is_linear());
    let weakest = axes.map(|(_, spec)| spec.acceleration_per_s2).fold(f64::INFINITY, f64::min);
    let (way, overtravel) = ((feed / 60.0).powi(2) / (2.0 * weakest), probe.overtravel_mm);
    if way <= overtravel { Ok(way) } else { Err(Reason::Braking { feed, way, overtravel }) }
}

pub fn length(from: &Position, to: &Position, overtravel: f64) -> Checked {
    let square = |axis: Axis| (to.at(axis) - from.at(axis)).powi(2);
    let length = Axis::LINEAR.into_iter().map(square).sum::<f64>().sqrt();
    if length <= overtravel + LENGTH_ROUNDING {
        return Ok(());
    }
    Err(Reason::TooLong { length, overtravel })
}

/// An axis that is not at its intended position.
pub struct Off {
    axis: Axis,
    /// Present position, mm or rad; `None`: unknown.
    is: Option<f64>,
    meant: f64,
}

impl Off {
    pub fn reason(self, why: impl FnOnce(Place) -> Reason) -> Reason {
        let Self { axis, is, meant } = self;
        match is {
            Some(is) => why(Place { axis, is: axis.to_edge(is), meant: axis.to_edge(meant) }),
            None => Reason::Unknown(axis),
        }
    }
}

/// The first axis of `meant` that is at another position, beyond rounding.
pub fn differs(stands: &Position, meant: &Position, dialect: &Dialect) -> Option<Off> {
    meant.iter().find_map(|(axis, meant)| {
        let Some(is) = stands.get(axis) else { return Some(Off { axis, is: None, meant }) };
        let off = match axis {
            Axis::S => (is - meant + PI).rem_euclid(TAU) - PI,
            _ => is - meant,
        };
        let same = off.abs() <= dialect.rounding(axis);
        (!same).then_some(Off { axis, is: Some(is), meant })
    })
}
