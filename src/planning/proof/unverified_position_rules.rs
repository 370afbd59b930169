//! Rules for an approach before touches have verified the position. No rapid is allowed. Only Z moves, unless Z is at
//! its upper end, or X and Y move along an octagon above the step before the first touch. Until that touch, a move
//! faster than a search keeps [`super::MIN_UNGUARDED_CLEARANCE_MM`] from everything. An axis turns so slowly that a
//! hold stops the carried parts within the overtravel.

use super::collision_scene::ClearanceRule;
use super::motion_rules;
use super::program_check::{CheckResult, ProgramCheck};
use super::refusal::RefusalReason;
use crate::gcode::rs274::ReadMotion;
use crate::unverified_position_approach::{
    SHORTEST_PROBED_LENGTH_MM, octagon_radius_mm, search_feed_before_first_touch_mm_min,
};
use machine::{Axis, Position};

/// Rounding tolerance of the text, mm.
const TEXT_ROUNDING_TOLERANCE_MM: f64 = 2e-3;

impl ProgramCheck<'_> {
    /// Checks that Z alone moves, or that Z is at its upper end.
    pub(super) fn check_z_alone_or_at_top(&self, target: &Position) -> CheckResult {
        let aside = |(axis, to): (Axis, f64)| {
            let expected = Position::new().with(axis, to);
            axis != Axis::Z
                && motion_rules::find_axis_mismatch(&self.position, &expected, self.request.dialect).is_some()
        };
        let top = self.request.plan.machine.axes.get(&Axis::Z).map(|spec| spec.max);
        let top: Position = top.map(|z| (Axis::Z, z)).into_iter().collect();
        let off = motion_rules::find_axis_mismatch(&self.position, &top, self.request.dialect);
        match off.filter(|_| target.iter().any(aside)) {
            Some(off) => Err(off.into_refusal_reason(RefusalReason::SidewaysMoveBelowTopZ)),
            None => Ok(()),
        }
    }

    /// Whether only X and Y move, no touch was made yet, and both ends of the move are within an octagon about the
    /// start of the step.
    fn is_octagon_move_above_step(&self, motion: &ReadMotion) -> bool {
        let Some(step) = self.current_step() else { return false };
        let plan = self.request.plan;
        let reach = octagon_radius_mm(plan) + TEXT_ROUNDING_TOLERANCE_MM;
        let over = |at: &Position| {
            let off = |axis| at.get_or_zero(axis) - step.from.get_or_zero(axis);
            let known = at.get(Axis::X).is_some() && at.get(Axis::Y).is_some();
            known && off(Axis::X).hypot(off(Axis::Y)) <= reach
        };
        let level = motion.target.iter().all(|(axis, _)| matches!(axis, Axis::X | Axis::Y));
        let ends = self.position.updated_by(&motion.target);
        level && !self.touched_directions.has_any_direction() && over(&self.position) && over(&ends)
    }

    /// Checks a turn of one axis, or a move that is too short for a probing move.
    pub(super) fn check_feed_move_at_unverified_position(&mut self, motion: &ReadMotion) -> CheckResult {
        self.check_z_alone_or_at_top(&motion.target)?;
        let plan = self.request.plan;
        if let Some(max_feed) = self.max_feed_of_single_axis_turn_deg_min(motion) {
            motion_rules::check_max_feed("the turn", motion, max_feed)?;
            return self.check_straight_move(&motion.target, &ClearanceRule::UnguardedMove);
        }
        motion_rules::check_max_feed("the short move", motion, search_feed_before_first_touch_mm_min(plan))?;
        let ends = self.position.updated_by(&motion.target);
        let turns = motion.target.iter().any(|(axis, _)| !axis.is_linear());
        let known = motion.target.iter().all(|(axis, _)| self.position.get(axis).is_some());
        let dialect = self.request.dialect;
        let is_at = |place: &Position| motion_rules::find_axis_mismatch(&self.position, place, dialect).is_none();
        // A feed move to the present position may occur above a step, because of rounding. At the start of the touch
        // it is refused: there, the next move must be the touch.
        let replaces_touch = is_at(&motion.target) && self.current_step().is_some_and(|step| is_at(&step.from));
        if turns
            || !known
            || replaces_touch
            || motion_rules::check_touch_length(&self.position, &ends, SHORTEST_PROBED_LENGTH_MM).is_err()
        {
            return Err(RefusalReason::UnexpectedFeedMove);
        }
        let rule = self.guarded_move_clearance_rule();
        self.check_straight_move(&motion.target, &rule)
    }

    /// Required clearance of a guarded move without rotary axes: until the first touch, a move faster than the search
    /// feed keeps the clearance of unguarded moves. Sideways moves below the upper end of Z are refused, except along
    /// an octagon.
    pub(super) fn guarded_clearance_rule_at_unverified_position(
        &self,
        motion: &ReadMotion,
    ) -> Result<ClearanceRule, RefusalReason> {
        if !self.is_octagon_move_above_step(motion) {
            self.check_z_alone_or_at_top(&motion.target)?;
        }
        let slow =
            motion_rules::check_max_feed("", motion, search_feed_before_first_touch_mm_min(self.request.plan)).is_ok();
        Ok(match slow || self.touched_directions.has_any_direction() {
            true => self.guarded_move_clearance_rule(),
            false => ClearanceRule::UnguardedMove,
        })
    }
}
