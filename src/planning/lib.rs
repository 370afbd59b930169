//! Converts steps to motions: touch cycle, ball measurement, clearances, order, first checks of travel, machine
//! time. The measuring methods are in `methods`. Module `proof` checks the rendered text for collisions.

#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

mod access;
mod ball;
mod ball_approach_path;
mod ball_evaluation;
mod ball_order;
mod error;
pub mod gcode;
mod gjk;
mod machine_time;
mod motion_sequence;
mod obstacle_body;
mod path_around_ball;
pub mod proof;
mod safe_heights;
mod scan;
mod stage_prompts;
mod surroundings;
mod tool_parts;
mod touch;
mod touched_directions;
mod travel_limits;
mod turn_feeds;
mod unverified_position_approach;

pub use access::{BallAccessError, BallMeasurementRequest, BallTouchMode, TouchAccess, TouchDirection};
pub use ball_evaluation::{BallCheckError, BallLimits, MeasuredBall, evaluate_ball};
pub use ball_order::TravelTimes;
pub use error::PlanningError;
pub use machine_time::{MachineTime, machine_time_s};
pub use safe_heights::SafeHeights;
pub use scan::{out_of_range_block_count, step_blocks};
pub use stage_prompts::split_prompts;
pub use touch::touch_block;
pub use touched_directions::{BlockStart, TouchedDirections};

use machine::record::motion::{Motion, MotionBlock};
use machine::record::plan::{Plan, Stage, Step};
use machine::{Axis, Position};

/// Blocks of all steps of `plan` in order, once each, from an unknown machine position; and the machine time, s. A plan
/// with a prompt is refused.
pub fn plan_blocks_and_time_s(
    plan: &Plan,
    safe_heights: &SafeHeights,
) -> Result<(Vec<MotionBlock>, f64), PlanningError> {
    let mut program = BlockSequence::default();
    for step in &plan.steps {
        program.push(plan, step, 0, safe_heights)?;
    }
    Ok((program.blocks, program.duration_s))
}

/// Like [`plan_blocks_and_time_s`], stage by stage as a run plans them: each with the artefact at its position
/// found so far. Prompts have no block; after a prompt, the position of the machine is unknown.
pub fn plan_blocks_and_time_s_by_stage(
    plan: &Plan,
    stages: &[Stage],
) -> Result<(Vec<MotionBlock>, f64), PlanningError> {
    let (mut program, mut found) = (BlockSequence::default(), None);
    for stage in stages {
        found = stage.found.as_ref().or(found);
        let safe_heights = SafeHeights::above_found_or_plan_artefact(plan, found)?;
        let (asked, moves) = split_prompts(plan, &stage.steps)?;
        if !asked.is_empty() {
            // The operator may have moved the machine.
            program.end_position = None;
            program.touched_directions = TouchedDirections::default();
        }
        for id in moves {
            let Some(step) = plan.steps.iter().find(|step| step.id == *id) else { continue };
            program.push(plan, step, stage.repeat, &safe_heights)?;
        }
    }
    Ok((program.blocks, program.duration_s))
}

/// Sequence of blocks, from an unknown machine position.
#[derive(Default)]
struct BlockSequence {
    blocks: Vec<MotionBlock>,
    /// Machine time of the blocks.
    duration_s: f64,
    /// Position after the last block; `None`: unknown.
    end_position: Option<Position>,
    touched_directions: TouchedDirections,
}

impl BlockSequence {
    /// Adds the blocks of `step`, planned from the end of the sequence, and their machine time.
    fn push(&mut self, plan: &Plan, step: &Step, repeat: u32, safe_heights: &SafeHeights) -> Result<(), PlanningError> {
        let start = BlockStart { position: self.end_position.as_ref(), touched_directions: self.touched_directions };
        let blocks = step_blocks(plan, step, repeat, start, safe_heights)?;
        for block in blocks {
            let begins = self.end_position.take().unwrap_or_default();
            self.duration_s += machine_time_s(&block, &begins, &plan.machine);
            self.end_position = Some(position_after_motions(&block.motions, &begins));
            self.blocks.push(block);
        }
        self.touched_directions = self.touched_directions.after_step(step);
        Ok(())
    }
}

/// Positions of the axes after `motions`: the last target of each axis. A touch counts as moving to its target.
pub fn position_after_motions<'a>(
    motions: impl IntoIterator<Item = &'a Motion>,
    start_position: &Position,
) -> Position {
    let targets = motions.into_iter().filter_map(motion_target);
    targets.fold(start_position.clone(), |position, to| position.updated_by(&to))
}

/// Target of a motion; `None` for a motion without one.
fn motion_target(motion: &Motion) -> Option<Position> {
    match motion {
        Motion::Rapid { to }
        | Motion::BackOff { to, .. }
        | Motion::Feed { to, .. }
        | Motion::Guarded { to, .. }
        | Motion::Probe { to, .. } => Some(to.clone()),
        Motion::OrientSpindle { s } => Some(Position::new().with(Axis::S, *s)),
        Motion::Dwell { .. } => None,
    }
}

#[cfg(test)]
mod tests;
