//! Path to the next touch of a ball, no higher than necessary.
//!
//! - From touch to touch of one ball: guarded, round the ball ([`super::round`]), or if an obstacle blocks that
//!   path, just above everything near.
//! - To another ball at the same rotary position: rapid, 10 mm above everything below the path.
//! - To another rotary position: rapid, 10 mm above everything that turns below *this* path.
//! - From an unknown position: by way of the upper end of Z, one axis group after the other. Until touches have
//!   confirmed the position of the machine, every path has this form, and is careful ([`super::careful`]).

use super::careful::UnconfirmedApproach;
use super::clearance::{LIFT, MARGIN};
use super::path::{Path, height};
use super::{Clearance, PlanningError, Start, round};
use machine::record::machine::Machine;
use machine::record::plan::{Plan, Step};
use machine::{Axis, Position};

/// Rounding tolerance of a position, mm.
const SLACK: f64 = 1e-6;
/// Maximum distance, seen from above, between the starts of two touches that count as touches of one ball, mm.
const ONE_BALL: f64 = 60.0;

/// Plans the path to the start of the touch, or above it. Returns the position at which the block ends: beside the
/// ball, or otherwise above it.
pub(super) fn approach(
    path: &mut Path,
    (plan, step): (&Plan, &Step),
    start: Start<'_>,
    clearance: &Clearance,
) -> Result<Position, PlanningError> {
    let machine = &plan.machine;
    let way = Way {
        machine,
        from: &step.from,
        lowest: step.from.at(Axis::Z).max(step.to.at(Axis::Z)),
        clearance,
    };
    if !clearance.about.upright(&step.from) {
        return Err(PlanningError::Tilted { step: step.id });
    }
    let high = way.z_above(&step.from, MARGIN);
    let above = || height(way.z_above(&step.from, LIFT));
    if !start.confirmed.is_all() {
        UnconfirmedApproach::new(plan, clearance, high, start.confirmed).over(path, &step.from);
        return Ok(above());
    }
    let known = |axis: Axis| axis == Axis::S || path.stands.get(axis).is_some();
    if !step.from.iter().all(|(axis, _)| known(axis)) || !clearance.about.upright(&path.stands) {
        way.begin_anywhere(path, high);
    } else if way.turns(path) {
        way.turning(path, high)?;
    } else {
        way.straight(path, high);
    }
    let aside = round::aside(&clearance.about, machine, &step.from);
    Ok(aside.unwrap_or_else(above))
}

struct Way<'a> {
    machine: &'a Machine,
    /// Start of the touch.
    from: &'a Position,
    /// Z of the path is never lower than the touch itself.
    lowest: f64,
    clearance: &'a Clearance,
}

impl Way<'_> {
    fn z_above(&self, at: &Position, margin: f64) -> f64 {
        self.clearance.about.z_between(at, at, margin).max(self.lowest)
    }

    fn turns(&self, path: &Path) -> bool {
        let mut rotary = self.from.iter().filter(|(axis, _)| !axis.is_linear());
        rotary.any(|(axis, value)| !path.stands_at(axis, value))
    }

    fn begin_anywhere(&self, path: &mut Path, high: f64) {
        path.rapid(&height(self.clearance.top_z));
        path.rapid(&self.from.only(|axis| !axis.is_linear() && axis != Axis::S));
        path.orient(self.from.get(Axis::S));
        path.rapid(&self.over());
        path.rapid(&height(high));
    }

    /// Moves the rotary axes and X, Y together: all obstacles are lower during the whole motion.
    fn turning(&self, path: &mut Path, high: f64) -> Result<(), PlanningError> {
        let needed = self.clearance.while_turning(&path.stands, self.from)?.max(high);
        self.rise(path, needed);
        let turned = self.from.only(|axis| !matches!(axis, Axis::Z | Axis::S));
        path.rapid(&turned);
        path.orient(self.from.get(Axis::S));
        path.rapid(&height(high));
        Ok(())
    }

    /// Moves the linear axes; the rotary axes are already in position.
    fn straight(&self, path: &mut Path, high: f64) {
        let apart = self.clearance.about.apart_from_above(&path.stands, self.from);
        let between = |margin| {
            let z = self.clearance.about.z_between(&path.stands, self.from, margin);
            z.max(self.lowest)
        };
        let places = round::round(&self.clearance.about, self.machine, &path.stands, self.from);
        if let Some(places) = places {
            for place in places {
                path.guarded(&place);
            }
            return;
        }
        if apart <= ONE_BALL {
            let needed = between(LIFT);
            if path.stands.at(Axis::Z) < needed - SLACK {
                path.guarded(&height(needed));
            }
            path.guarded(&self.over());
            return;
        }
        self.rise(path, between(MARGIN).max(high));
        path.rapid(&self.over());
        path.rapid(&height(high));
    }

    /// Raises Z to `needed`: guarded while an obstacle is near.
    fn rise(&self, path: &mut Path, needed: f64) {
        let z = path.stands.at(Axis::Z);
        if z >= needed - SLACK {
            return;
        }
        let here = |margin| self.clearance.about.z_between(&path.stands, &path.stands, margin);
        if z < here(LIFT) - SLACK {
            let clear = here(MARGIN).min(needed);
            path.guarded(&height(clear));
        }
        path.rapid(&height(needed));
    }

    fn over(&self) -> Position {
        self.from.only(|axis| matches!(axis, Axis::X | Axis::Y))
    }
}
