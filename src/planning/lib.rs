//! Converts steps to motions: touch cycle, ball measurement, clearances, order, first checks of travel, machine
//! time. Contains no method. Collisions are not checked here but in the rendered text, by `proof`.

#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

mod access;
mod asked;
mod ball;
mod careful;
mod clearance;
mod confirmed;
mod error;
pub mod gcode;
mod gjk;
mod hull;
mod limits;
mod measured;
mod order;
mod over_balls;
mod path;
pub mod proof;
mod round;
mod scan;
mod surroundings;
mod time;
mod tool;
mod touch;
mod turning;

pub use access::{Access, Contact, Unreachable};
pub use asked::asked_first;
pub use ball::{Approach, BallTask};
pub use clearance::Clearance;
pub use confirmed::{Confirmed, Start};
pub use error::PlanningError;
pub use measured::{BallDoubt, BallLimits, MeasuredBall, measured_ball};
pub use order::TravelTimes;
pub use scan::{blocks_out_of_range, step_blocks};
pub use time::{MachineTime, machine_time_s};
pub use touch::touch_block;

use machine::record::motion::{Block, Motion};
use machine::record::plan::{Plan, Stage, Step};
use machine::{Axis, Position};

/// Blocks of all steps of `plan` in order, once each, from an unknown machine position; and the machine time, s.
pub fn blocks(plan: &Plan, clearance: &Clearance) -> Result<(Vec<Block>, f64), PlanningError> {
    let mut program = Blocks::default();
    for step in &plan.steps {
        program.push(plan, step, 0, clearance)?;
    }
    Ok((program.blocks, program.seconds))
}

/// Like [`blocks`], stage by stage as a run plans them: each with the artefact at its position found so far.
/// Prompts have no block.
pub fn staged_blocks(plan: &Plan, stages: &[Stage]) -> Result<(Vec<Block>, f64), PlanningError> {
    let (mut program, mut found) = (Blocks::default(), None);
    for stage in stages {
        found = stage.found.as_ref().or(found);
        let clearance = Clearance::known(plan, found)?;
        let (asked, moves) = asked_first(plan, &stage.steps)?;
        if !asked.is_empty() {
            // The operator may have moved the machine.
            program.stands = None;
            program.confirmed = Confirmed::default();
        }
        for id in moves {
            let Some(step) = plan.steps.iter().find(|step| step.id == *id) else { continue };
            program.push(plan, step, stage.repeat, &clearance)?;
        }
    }
    Ok((program.blocks, program.seconds))
}

/// Sequence of blocks, from an unknown machine position.
#[derive(Default)]
struct Blocks {
    blocks: Vec<Block>,
    seconds: f64,
    stands: Option<Position>,
    confirmed: Confirmed,
}

impl Blocks {
    fn push(
        &mut self,
        plan: &Plan,
        step: &Step,
        repeat: u32,
        clearance: &Clearance,
    ) -> Result<(), PlanningError> {
        let start = Start { stands: self.stands.as_ref(), confirmed: self.confirmed };
        let blocks = step_blocks(plan, step, repeat, start, clearance)?;
        for block in blocks {
            let begins = self.stands.take().unwrap_or_default();
            self.seconds += machine_time_s(&block, &begins, &plan.machine);
            self.stands = Some(end_of(&block.motions, &begins));
            self.blocks.push(block);
        }
        self.confirmed = self.confirmed.after(step);
        Ok(())
    }
}

/// Positions of the axes after `motions`: the last target of each axis.
pub fn end_of<'a>(motions: impl IntoIterator<Item = &'a Motion>, begins: &Position) -> Position {
    motions.into_iter().fold(begins.clone(), |stands, motion| match target(motion) {
        Some(to) => stands.updated_by(&to),
        None => stands,
    })
}

/// Target of a motion; `None` for a motion without one.
fn target(motion: &Motion) -> Option<Position> {
    match motion {
        Motion::Rapid { to }
        | Motion::BackOff { to, .. }
        | Motion::Feed { to, .. }
        | Motion::Guarded { to, .. }
        | Motion::Probe { to, .. } => Some(to.clone()),
        Motion::Orient { s } => Some(Position::new().with(Axis::S, *s)),
        Motion::Dwell { .. } => None,
    }
}

#[cfg(test)]
mod tests;
