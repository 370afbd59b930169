//! The way to the next touch of a ball, no higher than it must be.
//!
//! - From touch to touch of one ball: guarded, just above whatever is near.
//! - To another ball at the same rotary position: fast, 10 mm above whatever is on the way.
//! - To another rotary position: fast, 10 mm above whatever turns below on *this* way.
//! - From where nobody knows: over the upper end of Z, one thing after the other.

use glam::DVec2;

use super::clearance::MARGIN;
use super::touch::{Path, height};
use super::{Clearance, PlanningError};
use crate::base::{Axis, Position};
use crate::record::plan::Step;

/// Free distance that guarded moves over a ball keep, and that a block ends with, mm. More than what
/// the proof asks of rapids, so that the next block may set out fast.
const LIFT: f64 = 3.0;
/// Rounding of a position, mm.
const SLACK: f64 = 1e-6;
/// Two touches whose starts are no further apart, seen from above, are of one ball or as good, mm.
const ONE_BALL: f64 = 60.0;

/// Over the start of the touch, a guarded move down from it. Returns Z to end at.
pub(super) fn approach(
    path: &mut Path,
    step: &Step,
    first: bool,
    clearance: &Clearance,
) -> Result<f64, PlanningError> {
    let way = Way {
        from: &step.from,
        lowest: step.from.at(Axis::Z).max(step.to.at(Axis::Z)),
        clearance,
        first,
    };
    if !clearance.about.upright(&step.from) {
        return Err(PlanningError::Tilted { step: step.id });
    }
    let high = way.z_above(&step.from, MARGIN);
    let known = |axis: Axis| axis == Axis::S || path.stands.get(axis).is_some();
    if !step.from.iter().all(|(axis, _)| known(axis)) || !clearance.about.upright(&path.stands) {
        way.begin_anywhere(path, high);
    } else if way.turns(path) {
        way.turning(path, high)?;
    } else {
        way.straight(path, high);
    }
    Ok(way.z_above(&step.from, LIFT))
}

struct Way<'a> {
    /// Where the touch begins.
    from: &'a Position,
    /// Z is never planned lower than the touch itself.
    lowest: f64,
    clearance: &'a Clearance,
    /// The first approach since the control was prepared.
    first: bool,
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

    /// The rotary axes and X, Y together: all that could be met is lower all the way.
    fn turning(&self, path: &mut Path, high: f64) -> Result<(), PlanningError> {
        let needed = self.clearance.while_turning(&path.stands, self.from)?.max(high);
        self.rise(path, needed);
        let turned = self.from.only(|axis| !matches!(axis, Axis::Z | Axis::S));
        path.rapid(&turned);
        path.orient(self.from.get(Axis::S));
        path.rapid(&height(high));
        Ok(())
    }

    /// The rotary axes stand as they should.
    fn straight(&self, path: &mut Path, high: f64) {
        let plan_view = |at: &Position| self.clearance.about.tip_at(at).truncate();
        let apart: DVec2 = plan_view(self.from) - plan_view(&path.stands);
        let between = |margin| {
            let z = self.clearance.about.z_between(&path.stands, self.from, margin);
            z.max(self.lowest)
        };
        if apart.length() <= ONE_BALL {
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

    /// Up to `needed`: guarded as long as something is near, and all the way if nothing is known yet
    /// of where it stands.
    fn rise(&self, path: &mut Path, needed: f64) {
        let z = path.stands.at(Axis::Z);
        if z >= needed - SLACK {
            return;
        }
        let here = |margin| self.clearance.about.z_between(&path.stands, &path.stands, margin);
        if self.first {
            path.guarded(&height(needed));
        } else if z < here(LIFT) - SLACK {
            let clear = here(MARGIN).min(needed);
            path.guarded(&height(clear));
        }
        path.rapid(&height(needed));
    }

    fn over(&self) -> Position {
        self.from.only(|axis| matches!(axis, Axis::X | Axis::Y))
    }
}
