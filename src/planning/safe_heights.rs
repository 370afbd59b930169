//! Height of Z at which all other axes may move.

use super::PlanningError;
use super::surroundings::Surroundings;
use machine::kinematics::KinematicsError;
use machine::record::artefact::Artefact;
use machine::record::machine::Machine;
use machine::record::plan::{Plan, StepKind};
use machine::{Axis, Position};

/// Clearance between the tool and bodies that it passes over unguarded, mm.
pub(super) const PLANNED_UNGUARDED_CLEARANCE_MM: f64 = 10.0;
/// Clearance of guarded moves over a ball, and at the end of a block, mm. It is larger than the clearance that the
/// proof requires of rapids, so that the next block may start with a rapid.
pub(super) const PLANNED_GUARDED_CLEARANCE_MM: f64 = 3.0;
/// Maximum interval at which the motion of rotary axes is checked, rad.
const MAX_ROTARY_CHECK_INTERVAL_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;

/// Safe heights as Z commands, mm, and the obstacles that they clear.
#[derive(Debug, Clone)]
pub struct SafeHeights {
    /// The upper end of Z, where the first block goes if the position of the machine is unknown.
    pub(super) top_z: f64,
    /// The lower end of Z.
    lower_z_limit: f64,
    pub(super) surroundings: Surroundings,
    /// For a round part: height at or above which the stylus ball, and everything above it, passes over the part
    /// and over every solid and kept-out box that Z can pass over, at every rotary position of the plan and during
    /// the motions between them. `None` for any other artefact: each path has its own height.
    pub(super) part_clearance_z: Option<f64>,
}

impl SafeHeights {
    /// Safe heights for `plan`. For a round part, at all rotary positions of the steps, with a margin of 10 mm and
    /// the declared uncertainty of its position; for balls, each path has its own height. A solid that is too high
    /// for Z is ignored: the proof decides whether the path leads past it.
    ///
    /// # Errors
    /// Z ends below that height, or moves down on a positive command; the machine has no kinematics.
    pub fn above_plan_artefact(plan: &Plan) -> Result<Self, PlanningError> {
        Self::above_artefact(plan, &plan.artefact)
    }

    /// Height for the planning of a stage during a run: above balls at the positions found so far, or above a round
    /// part at its position in the plan.
    ///
    /// # Errors
    /// The errors of [`SafeHeights::above_plan_artefact`].
    pub fn above_found_or_plan_artefact(plan: &Plan, found: Option<&Artefact>) -> Result<Self, PlanningError> {
        match found {
            Some(balls @ Artefact::Balls(_)) => Self::above_artefact(plan, balls),
            _ => Self::above_plan_artefact(plan),
        }
    }

    /// Like [`SafeHeights::above_plan_artefact`], with the artefact at its found position.
    pub fn above_artefact(plan: &Plan, artefact: &Artefact) -> Result<Self, PlanningError> {
        let surroundings = Surroundings::new(plan, artefact)?;
        if !surroundings.does_positive_z_lift_tool() {
            return Err(PlanningError::InvertedZ);
        }
        let (min_z, top_z) = z_limits_mm(&plan.machine)?;
        let mut clearance = Self { top_z, lower_z_limit: min_z, surroundings, part_clearance_z: None };
        if let Artefact::Cylinder(_) = artefact {
            clearance.part_clearance_z = Some(clearance.clearance_z_over_poses(rotary_positions_along_plan(plan))?);
        }
        Ok(clearance)
    }

    /// Safe height, as a Z command, mm, while the rotary axes move straight from `one` to `next`.
    pub(super) fn turning_clearance_z(&self, one: &Position, next: &Position) -> Result<f64, PlanningError> {
        let ways = interpolate_rotary_positions(one, next);
        self.clearance_z_over_poses([rotary_axis_positions(one)].into_iter().chain(ways))
    }

    /// Largest Z command that one of the rotary positions `poses` requires; at least the lower end of Z.
    fn clearance_z_over_poses(&self, poses: impl IntoIterator<Item = Position>) -> Result<f64, PlanningError> {
        let max = self.top_z;
        let no_room = |needed| PlanningError::InsufficientZTravel { needed, max };
        poses.into_iter().try_fold(self.lower_z_limit, |needed, pose| {
            let clear = self.surroundings.clear_z_command_everywhere(&pose, PLANNED_UNGUARDED_CLEARANCE_MM);
            Ok(needed.max(clear.map_err(no_room)?))
        })
    }
}

/// Positions of the rotary axes and of the spindle.
fn rotary_axis_positions(position: &Position) -> Position {
    position.filter_axes(|axis| !axis.is_linear())
}

/// Positions of the rotary axes and the spindle at `from` of each step, and along the straight path from there to `from`
/// of the next step. Prompts are left out. Without a moving step: one empty position.
fn rotary_positions_along_plan(plan: &Plan) -> Vec<Position> {
    // A prompt has no position.
    let mut moving = plan.steps.iter().filter(|step| step.kind != StepKind::Prompt).peekable();
    let mut poses: Vec<Position> = moving.peek().map(|step| rotary_axis_positions(&step.from)).into_iter().collect();
    while let (Some(one), Some(next)) = (moving.next(), moving.peek()) {
        poses.extend(interpolate_rotary_positions(&one.from, &next.from));
    }
    if poses.is_empty() { vec![Position::new()] } else { poses }
}

/// Positions of the rotary axes after `one` up to and including `next`.
fn interpolate_rotary_positions(one: &Position, next: &Position) -> Vec<Position> {
    let next = rotary_axis_positions(next);
    let farthest = next.iter().map(|(axis, to)| (to - one.get_or_zero(axis)).abs()).fold(0.0_f64, f64::max);
    let count = (farthest / MAX_ROTARY_CHECK_INTERVAL_RAD).ceil() as u32;
    let at = |k: u32| {
        let share = f64::from(k) / f64::from(count);
        next.iter().map(|(axis, to)| (axis, one.get_or_zero(axis) + share * (to - one.get_or_zero(axis)))).collect()
    };
    (1..=count).map(at).collect()
}

fn z_limits_mm(machine: &Machine) -> Result<(f64, f64), PlanningError> {
    let topology = machine.topology.clone();
    let missing = KinematicsError::NotInAxes { axis: Axis::Z, topology };
    let spec = machine.axes.get(&Axis::Z).ok_or(missing)?;
    Ok((spec.min, spec.max))
}
