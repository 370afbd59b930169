//! Path to the next touch of a ball, no higher than necessary.
//!
//! - From touch to touch of one ball: guarded, around the ball ([`super::path_around_ball`]), or if an obstacle blocks
//!   that path, just above everything near.
//! - To another ball at the same rotary position: rapid, 10 mm above everything below the path.
//! - To another rotary position: rapid, 10 mm above everything that turns below *this* path.
//! - From an unknown position: by way of the upper end of Z, one axis group after the other. Until touches have
//!   verified the position of the machine, every path has this form, and is careful
//!   ([`super::unverified_position_approach`]).

use super::motion_sequence::{MotionSequence, z_position};
use super::safe_heights::{PLANNED_GUARDED_CLEARANCE_MM, PLANNED_UNGUARDED_CLEARANCE_MM};
use super::unverified_position_approach::UnverifiedPositionApproach;
use super::{BlockStart, PlanningError, SafeHeights, path_around_ball};
use machine::record::machine::Machine;
use machine::record::plan::{Plan, Step};
use machine::{Axis, Position};

/// Rounding tolerance of a position, mm.
const POSITION_TOLERANCE_MM: f64 = 1e-6;
/// Maximum distance, seen from above, between the starts of two touches that count as touches of one ball, mm.
const MAX_SAME_BALL_DISTANCE_MM: f64 = 60.0;

/// Plans the path to the start of the touch, or to a point above the start. Returns the position at which the block
/// ends: beside the ball if possible, otherwise above the ball.
///
/// # Errors
/// The spindle is tilted at the touch, or Z has too little travel for the rotary move.
pub(super) fn plan_ball_approach_and_block_end(
    path: &mut MotionSequence,
    plan: &Plan,
    step: &Step,
    start: BlockStart<'_>,
    safe_heights: &SafeHeights,
) -> Result<Position, PlanningError> {
    let machine = &plan.machine;
    let ball_path = BallApproachPath {
        machine,
        touch_start: &step.from,
        highest_touch_z: step.from.get_or_zero(Axis::Z).max(step.to.get_or_zero(Axis::Z)),
        safe_heights,
    };
    if !safe_heights.surroundings.is_spindle_upright(&step.from) {
        return Err(PlanningError::SpindleTilted { step: step.id });
    }
    let high = ball_path.clearance_z_above(&step.from, PLANNED_UNGUARDED_CLEARANCE_MM);
    let above = || z_position(ball_path.clearance_z_above(&step.from, PLANNED_GUARDED_CLEARANCE_MM));
    if !start.touched_directions.has_three_independent_directions() {
        UnverifiedPositionApproach::new(plan, safe_heights, high, start.touched_directions)
            .move_above(path, &step.from);
        return Ok(above());
    }
    let known = |axis: Axis| axis == Axis::S || path.end_position.get(axis).is_some();
    if !step.from.iter().all(|(axis, _)| known(axis))
        || !safe_heights.surroundings.is_spindle_upright(&path.end_position)
    {
        ball_path.move_via_top_z(path, high);
    } else if ball_path.needs_rotary_move(path) {
        ball_path.move_with_rotary_axes(path, high)?;
    } else {
        ball_path.move_linear_axes(path, high);
    }
    let aside = path_around_ball::block_end_beside_ball(&safe_heights.surroundings, machine, &step.from);
    Ok(aside.unwrap_or_else(above))
}

/// Path to the start of the next touch of a ball.
struct BallApproachPath<'a> {
    machine: &'a Machine,
    /// Start of the touch.
    touch_start: &'a Position,
    /// Higher Z of the two ends of the touch; the path is nowhere lower.
    highest_touch_z: f64,
    safe_heights: &'a SafeHeights,
}

impl BallApproachPath<'_> {
    /// Z command from which on the tool is `margin` clear of everything below it at `at`; never below the touch.
    fn clearance_z_above(&self, at: &Position, margin: f64) -> f64 {
        self.safe_heights.surroundings.clear_z_command_on_path(at, at, margin).max(self.highest_touch_z)
    }

    /// Whether a rotary axis or S is not at the position of the touch.
    fn needs_rotary_move(&self, path: &MotionSequence) -> bool {
        let mut rotary = self.touch_start.iter().filter(|(axis, _)| !axis.is_linear());
        rotary.any(|(axis, value)| !path.is_at(axis, value))
    }

    /// Raises Z to its upper end, then moves the rotary axes, the spindle, X and Y, and last Z down to `high`.
    fn move_via_top_z(&self, path: &mut MotionSequence, high: f64) {
        path.add_rapid(&z_position(self.safe_heights.top_z));
        path.add_rapids_across_and_down(self.touch_start, high);
    }

    /// Moves the rotary axes, X and Y together, at a Z above all obstacles during the whole motion.
    fn move_with_rotary_axes(&self, path: &mut MotionSequence, high: f64) -> Result<(), PlanningError> {
        let needed = self.safe_heights.turning_clearance_z(&path.end_position, self.touch_start)?.max(high);
        self.raise_z(path, needed);
        let turned = self.touch_start.filter_axes(|axis| !matches!(axis, Axis::Z | Axis::S));
        path.add_rapid(&turned);
        path.add_spindle_orientation(self.touch_start.get(Axis::S));
        path.add_rapid(&z_position(high));
        Ok(())
    }

    /// Moves the linear axes; the rotary axes are already in position. Near the same ball the moves are guarded, to
    /// another ball rapid.
    fn move_linear_axes(&self, path: &mut MotionSequence, high: f64) {
        let (surroundings, from) = (&self.safe_heights.surroundings, &path.end_position);
        let apart = surroundings.xy_distance_mm(from, self.touch_start);
        let between =
            |margin| surroundings.clear_z_command_on_path(from, self.touch_start, margin).max(self.highest_touch_z);
        let places = path_around_ball::plan_path_around_ball(surroundings, self.machine, from, self.touch_start);
        if let Some(places) = places {
            for place in places {
                path.add_guarded_move(&place);
            }
            return;
        }
        if apart <= MAX_SAME_BALL_DISTANCE_MM {
            let needed = between(PLANNED_GUARDED_CLEARANCE_MM);
            if path.end_position.get_or_zero(Axis::Z) < needed - POSITION_TOLERANCE_MM {
                path.add_guarded_move(&z_position(needed));
            }
            path.add_guarded_move(&self.xy_of_touch_start());
            return;
        }
        self.raise_z(path, between(PLANNED_UNGUARDED_CLEARANCE_MM).max(high));
        path.add_rapid(&self.xy_of_touch_start());
        path.add_rapid(&z_position(high));
    }

    /// Raises Z to `needed`: guarded while an obstacle is near. No motion if Z is already at this height or above.
    fn raise_z(&self, path: &mut MotionSequence, needed: f64) {
        let z = path.end_position.get_or_zero(Axis::Z);
        if z >= needed - POSITION_TOLERANCE_MM {
            return;
        }
        let here = |margin| {
            self.safe_heights.surroundings.clear_z_command_on_path(&path.end_position, &path.end_position, margin)
        };
        if z < here(PLANNED_GUARDED_CLEARANCE_MM) - POSITION_TOLERANCE_MM {
            let clear = here(PLANNED_UNGUARDED_CLEARANCE_MM).min(needed);
            path.add_guarded_move(&z_position(clear));
        }
        path.add_rapid(&z_position(needed));
    }

    fn xy_of_touch_start(&self) -> Position {
        self.touch_start.filter_axes(|axis| matches!(axis, Axis::X | Axis::Y))
    }
}
