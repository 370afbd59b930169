//! Rules for an approach before touches have confirmed the position. No rapid is allowed. Only Z moves, unless Z is
//! at its upper end, or X and Y make a round above the step before the first touch. Until that touch, a move faster
//! than a search keeps [`MARGIN_MM`] from everything. An axis turns so slowly that a hold stops the carried parts
//! within the overtravel.

use super::MARGIN_MM;
use super::refusal::Reason;
use super::rules;
use super::scene::ClearanceRule;
use super::walk::{Checked, ProgramCheck};
use crate::careful::{SHORT_MM, round_mm, search_feed};
use crate::gcode::rs274::ReadMotion;
use crate::turning;
use machine::{Axis, Position};

/// Rounding tolerance of the text, mm.
const ROUNDING_MM: f64 = 2e-3;

impl ProgramCheck<'_> {
    /// Checks that Z alone moves, or that Z is at its upper end.
    pub(super) fn is_high(&self, target: &Position) -> Checked {
        let aside = |(axis, to): (Axis, f64)| {
            let meant = Position::new().with(axis, to);
            axis != Axis::Z
                && rules::differs(self.stands(), &meant, self.request().dialect).is_some()
        };
        let top = self.request().plan.machine.axes.get(&Axis::Z).map(|spec| spec.max);
        let top: Position = top.map(|z| (Axis::Z, z)).into_iter().collect();
        let off = rules::differs(self.stands(), &top, self.request().dialect);
        match off.filter(|_| target.iter().any(aside)) {
            Some(off) => Err(off.reason(Reason::AsideBelowTop)),
            None => Ok(()),
        }
    }

    /// Whether X and Y make a round above the step before the first touch.
    fn feels_around(&self, motion: &ReadMotion) -> bool {
        let Some(step) = self.step() else { return false };
        let plan = self.request().plan;
        let reach = round_mm(plan) + ROUNDING_MM;
        let over = |at: &Position| {
            let off = |axis| at.at(axis) - step.from.at(axis);
            let known = at.get(Axis::X).is_some() && at.get(Axis::Y).is_some();
            known && off(Axis::X).hypot(off(Axis::Y)) <= reach
        };
        let level = motion.target.iter().all(|(axis, _)| matches!(axis, Axis::X | Axis::Y));
        let ends = self.stands().updated_by(&motion.target);
        level && !self.confirmed.is_begun() && over(self.stands()) && over(&ends)
    }

    /// Checks a turn of one axis, or a move that is too short for a probing move.
    pub(super) fn careful_feed(&mut self, motion: &ReadMotion) -> Checked {
        self.is_high(&motion.target)?;
        let plan = self.request().plan;
        let mut moved = motion.target.iter();
        if let (Some((axis, _)), None) = (moved.next(), moved.next())
            && !axis.is_linear()
        {
            let most = turning::feed_at_most(plan, &self.chain, axis, self.stands());
            rules::feed_at_most("a turn", motion, most)?;
            return self.go(&motion.target, &ClearanceRule::Apart(MARGIN_MM));
        }
        rules::feed_at_most("a short way", motion, search_feed(plan))?;
        let ends = self.stands().updated_by(&motion.target);
        let turns = motion.target.iter().any(|(axis, _)| !axis.is_linear());
        let known = motion.target.iter().all(|(axis, _)| self.stands().get(axis).is_some());
        let dialect = self.request().dialect;
        let is_at = |place: &Position| rules::differs(self.stands(), place, dialect).is_none();
        // The machine may already be above a step within rounding; at the start of the touch, the next move must be
        // the touch.
        let replaces_touch =
            is_at(&motion.target) && self.step().is_some_and(|step| is_at(&step.from));
        if turns
            || !known
            || replaces_touch
            || rules::length(self.stands(), &ends, SHORT_MM).is_err()
        {
            return Err(Reason::FeedMove);
        }
        let care = self.guarded_care();
        self.go(&motion.target, &care)
    }

    /// Required clearance of a guarded move without rotary axes.
    pub(super) fn careful_guarded(&self, motion: &ReadMotion) -> Result<ClearanceRule, Reason> {
        if !self.feels_around(motion) {
            self.is_high(&motion.target)?;
        }
        let slow = rules::feed_at_most("", motion, search_feed(self.request().plan)).is_ok();
        Ok(match slow || self.confirmed.is_begun() {
            true => self.guarded_care(),
            false => ClearanceRule::Apart(MARGIN_MM),
        })
    }
}
