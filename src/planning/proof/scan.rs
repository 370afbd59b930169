//! Proof of a scan: the text reaches the points of its path one after the other, at its feed. It rests at each point
//! where samples are taken at rest, and nowhere if they are taken during the motion. No part of it touches: all of it
//! keeps [`super::MIN_UNGUARDED_CLEARANCE_MM`], except that the ball in a nest of sensors on the table may be as near
//! as their range allows.

use super::collision_scene::ClearanceRule;
use super::motion_rules;
use super::program_check::{CheckResult, ProgramCheck, StepPhase};
use super::refusal::RefusalReason;
use crate::gcode::rs274::{MotionKind, ReadMotion};
use crate::turn_feeds;
use crate::unverified_position_approach::{are_step_sensors_on_table, max_nest_feed_mm_min, near_part_feed_mm_min};
use machine::record::plan::{Sampling, Scan, Step};
use machine::{Axis, Position};

/// Rounding tolerance of times, which have three decimals, s.
const DWELL_TOLERANCE_S: f64 = 0.000_501;

impl ProgramCheck<'_> {
    pub(super) fn check_scan_motion(&mut self, motion: &ReadMotion, step: &Step, scan: &Scan) -> CheckResult {
        self.begin_scan_in_place(scan)?;
        match (motion.kind, self.step_phase) {
            (MotionKind::Dwell { seconds }, StepPhase::Scanning { reached_count, dwelled_s }) => {
                if matches!(scan.sampling, Sampling::Continuous { .. }) {
                    return Err(RefusalReason::DwellInContinuousScan);
                }
                self.step_phase = StepPhase::Scanning { reached_count, dwelled_s: dwelled_s + seconds };
                Ok(())
            }
            (MotionKind::Dwell { .. }, _) => Ok(()),
            (MotionKind::Feed, StepPhase::Scanning { reached_count, .. }) => {
                self.check_dwell_complete(scan)?;
                motion_rules::check_exact_feed("the scan", motion, step.feed_mm_min)?;
                if self.are_step_sensors_on_table() && !has_rotary_target(motion) {
                    let max_feed = max_nest_feed_mm_min(self.request.plan);
                    motion_rules::check_max_feed("the move between sensors", motion, max_feed)?;
                }
                self.check_move_to_scan_point(motion, scan, reached_count)
            }
            (MotionKind::Feed, _) => {
                let ends = self.position.updated_by(&motion.target);
                match motion_rules::find_axis_mismatch(&ends, &first_point_without_s(scan)?, self.request.dialect) {
                    None => {
                        let most = self.max_scan_approach_feed(motion, scan)?;
                        motion_rules::check_max_feed("the approach to the scan", motion, most)?;
                        self.check_move_to_scan_point(motion, scan, 0)
                    }
                    Some(_) => self.check_scan_approach(motion),
                }
            }
            (MotionKind::ProgramStop, _) => Err(RefusalReason::UnexpectedProgramStop),
            (_, StepPhase::Scanning { .. }) => Err(RefusalReason::OffScanPath),
            (MotionKind::Rapid, _) if !self.is_machine_position_verified() => {
                Err(RefusalReason::RapidBeforePositionVerified)
            }
            (MotionKind::Rapid, _) => self.check_straight_move(&motion.target, &ClearanceRule::UnguardedMove),
            (MotionKind::OrientSpindle { s }, _) => self.check_spindle_orientation(s),
            (MotionKind::Probe { .. }, _) => Err(RefusalReason::ProbingMoveInScan),
        }
    }

    /// Maximum feed of the last move to the first point, mm/min or degrees/min. Until the position is verified, the
    /// feed of a turn is limited by [`turn_feeds`], and an axis that the scan itself does not turn may turn only with
    /// Z at its upper end.
    fn max_scan_approach_feed(&self, motion: &ReadMotion, scan: &Scan) -> Result<f64, RefusalReason> {
        let plan = self.request.plan;
        let in_nest = self.are_step_sensors_on_table();
        let near =
            if in_nest { max_nest_feed_mm_min(plan) } else { near_part_feed_mm_min(plan, self.touched_directions) };
        if self.is_machine_position_verified() {
            let turn = self.max_feed_of_single_axis_turn_deg_min(motion).filter(|_| in_nest);
            return Ok(turn.unwrap_or(near));
        }
        let does_scan_turn =
            |axis: Axis| scan.path.windows(2).any(|way| way[0].get_or_zero(axis) != way[1].get_or_zero(axis));
        let mut rotary = motion.target.iter().filter(|(axis, _)| !axis.is_linear());
        if rotary.any(|(axis, _)| !does_scan_turn(axis)) {
            self.check_z_alone_or_at_top(&motion.target)?;
        }
        Ok(self.max_feed_of_single_axis_turn_deg_min(motion).unwrap_or(near))
    }

    /// Maximum feed of a motion that turns one axis, degrees/min; `None` for any other motion.
    pub(super) fn max_feed_of_single_axis_turn_deg_min(&self, motion: &ReadMotion) -> Option<f64> {
        let mut moved = motion.target.iter().map(|(axis, _)| axis);
        let turned = moved.next().filter(|axis| !axis.is_linear() && moved.next().is_none())?;
        let plan = self.request.plan;
        Some(turn_feeds::max_turn_feed_deg_min(plan, &self.chain, turned, &self.position))
    }

    /// Whether the sensors of the current step are on the table.
    fn are_step_sensors_on_table(&self) -> bool {
        self.current_step().is_some_and(|step| are_step_sensors_on_table(self.request.plan, step))
    }

    /// Clearance rule for a feed move of a scan. Only a turn, or a move that is slow enough for a hold to stop in time,
    /// may be as near to the sensors of a nest as their range allows.
    fn scan_move_clearance_rule(&self, motion: &ReadMotion) -> ClearanceRule {
        let is_slow = || motion_rules::check_max_feed("", motion, max_nest_feed_mm_min(self.request.plan)).is_ok();
        match self.are_step_sensors_on_table() && (has_rotary_target(motion) || is_slow()) {
            true => ClearanceRule::UnguardedInNest,
            false => ClearanceRule::UnguardedMove,
        }
    }

    /// Begins a scan of rotary axes without an approach if the machine is already at its first point.
    fn begin_scan_in_place(&mut self, scan: &Scan) -> CheckResult {
        let is_any = matches!(self.step_phase, StepPhase::Scanning { .. });
        if is_any || !scan.is_rotary_only() {
            return Ok(());
        }
        if motion_rules::find_axis_mismatch(&self.position, &first_point_without_s(scan)?, self.request.dialect)
            .is_none()
        {
            self.step_phase = StepPhase::Scanning { reached_count: 1, dwelled_s: 0.0 };
        }
        Ok(())
    }

    /// Checks a feed move before the first point.
    fn check_scan_approach(&mut self, motion: &ReadMotion) -> CheckResult {
        if !self.is_machine_position_verified() && has_rotary_target(motion) {
            return self.check_feed_move_at_unverified_position(motion);
        }
        if !self.is_machine_position_verified() {
            self.check_z_alone_or_at_top(&motion.target)?;
        }
        let turn = self.max_feed_of_single_axis_turn_deg_min(motion).filter(|_| self.are_step_sensors_on_table());
        let most = turn.unwrap_or(self.request.plan.probe.guarded_feed_mm_min);
        motion_rules::check_max_feed("the approach to the scan", motion, most)?;
        self.check_straight_move(&motion.target, &self.scan_move_clearance_rule(motion))
    }

    /// Checks that the move reaches the next point of the path, which has the index `number`.
    fn check_move_to_scan_point(&mut self, motion: &ReadMotion, scan: &Scan, number: usize) -> CheckResult {
        let ends = self.position.updated_by(&motion.target);
        let point = scan.path.get(number).ok_or(RefusalReason::OffScanPath)?;
        if let Some(off) = motion_rules::find_axis_mismatch(&ends, point, self.request.dialect) {
            return Err(off.into_refusal_reason(RefusalReason::WrongScanPoint));
        }
        self.check_straight_move(&motion.target, &self.scan_move_clearance_rule(motion))?;
        self.step_phase = StepPhase::Scanning { reached_count: number + 1, dwelled_s: 0.0 };
        Ok(())
    }

    /// Checks that the scan has rested long enough at the present point.
    fn check_dwell_complete(&self, scan: &Scan) -> CheckResult {
        match (scan.sampling, self.step_phase) {
            (Sampling::Dwell { dwell_s, .. }, StepPhase::Scanning { dwelled_s, .. })
                if dwelled_s < dwell_s - DWELL_TOLERANCE_S =>
            {
                Err(RefusalReason::StepIncomplete("the dwell at a point of the scan"))
            }
            _ => Ok(()),
        }
    }

    /// Checks that the scan has reached all of its points, and has rested long enough at the last one.
    pub(super) fn check_scan_complete(&self, scan: &Scan) -> CheckResult {
        self.check_dwell_complete(scan)?;
        match self.step_phase {
            StepPhase::Scanning { reached_count, .. } if reached_count == scan.path.len() => Ok(()),
            _ => Err(RefusalReason::StepIncomplete("reaching all points of the scan")),
        }
    }
}

/// Whether the target contains a rotary axis, even if the axis keeps its position.
fn has_rotary_target(motion: &ReadMotion) -> bool {
    motion.target.iter().any(|(axis, _)| !axis.is_linear())
}

/// First point of the scan without the spindle, which is oriented separately.
fn first_point_without_s(scan: &Scan) -> Result<Position, RefusalReason> {
    let first = scan.path.first().ok_or(RefusalReason::OffScanPath)?;
    Ok(first.filter_axes(|axis| axis != Axis::S))
}
