//! What holds of a motion by its words alone: limits, feeds, lengths, where it begins and ends.

use std::f64::consts::{PI, TAU};

use super::refusal::{Place, Reason};
use crate::gcode::Dialect;
use crate::gcode::rs274::{Kind, ReadMotion};
use machine::record::machine::{Machine, Probe};
use machine::{Axis, Position};

/// Feeds are written with three decimals, mm/min.
const FEED_ROUNDING: f64 = 0.000_501;
/// Lengths of a touch come from numbers that were rounded, mm.
const LENGTH_ROUNDING: f64 = 1e-3;

type Checked = Result<(), Reason>;

/// Every axis is there and stays within its limits. The spindle is oriented within a turn: it may
/// stand where any full turn more or less is within.
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

/// Way from the feed to rest, mm, whichever linear axis brakes: within the probe's overtravel.
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

/// An axis that stands elsewhere than it should.
pub struct Off {
    axis: Axis,
    /// mm or rad; `None`: nobody knows.
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

/// The first axis of `meant` that stands elsewhere, beyond rounding.
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
