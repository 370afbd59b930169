//! Height of Z at which all other axes may move.

use super::PlanningError;
use super::surroundings::Surroundings;
use machine::kinematics::KinematicsError;
use machine::record::artefact::Artefact;
use machine::record::machine::Machine;
use machine::record::plan::{Plan, StepKind};
use machine::{Axis, Position};

/// Clearance between the tool and bodies that it passes over unguarded, mm.
pub(super) const MARGIN: f64 = 10.0;
/// Clearance of guarded moves over a ball, and at the end of a block, mm. It is larger than the clearance that the
/// proof requires of rapids, so that the next block may start with a rapid.
pub(super) const LIFT: f64 = 3.0;
/// Maximum interval at which the motion of rotary axes is checked, rad.
const ROTARY_STRIDE: f64 = 5.0 * std::f64::consts::PI / 180.0;

/// Safe heights. Z commands, mm.
#[derive(Debug, Clone)]
pub struct Clearance {
    /// The upper end of Z, where the first block goes if the position of the machine is unknown.
    pub(super) top_z: f64,
    min_z: f64,
    pub(super) about: Surroundings,
    /// For a round part: height at or above which the stylus ball, and everything above it, passes over the part
    /// and over every solid and kept-out box that Z can pass over, at every rotary position of the plan and during
    /// the motions between them. `None` for balls: each path has its own height.
    pub(super) over_all: Option<f64>,
}

impl Clearance {
    /// Height above the artefact of `plan` at all rotary positions of its steps, with a margin of 10 mm and the
    /// declared uncertainty of its position. A solid that is too high for Z is ignored: the proof decides whether
    /// the path leads past it.
    ///
    /// # Errors
    /// Z ends below that height, or moves down on a positive command; the machine has no kinematics.
    pub fn above(plan: &Plan) -> Result<Self, PlanningError> {
        Self::over(plan, &plan.artefact)
    }

    /// Height with the knowledge at the time when a stage is planned: balls at the positions found so far, a round
    /// part at its position in the plan.
    ///
    /// # Errors
    /// As [`Clearance::above`].
    pub fn known(plan: &Plan, found: Option<&Artefact>) -> Result<Self, PlanningError> {
        match found {
            Some(balls @ Artefact::Balls(_)) => Self::over(plan, balls),
            _ => Self::above(plan),
        }
    }

    /// Like [`Clearance::above`], with the artefact at its found position.
    pub fn over(plan: &Plan, artefact: &Artefact) -> Result<Self, PlanningError> {
        let about = Surroundings::new(plan, artefact)?;
        if !about.z_lifts() {
            return Err(PlanningError::ZDown);
        }
        let (min_z, top_z) = z_travel(&plan.machine)?;
        let mut clearance = Self { top_z, min_z, about, over_all: None };
        if let Artefact::Cylinder(_) = artefact {
            clearance.over_all = Some(clearance.over_poses(rotary_poses(plan))?);
        }
        Ok(clearance)
    }

    /// Height while the rotary axes move straight from one position to the other.
    pub(super) fn while_turning(
        &self,
        one: &Position,
        next: &Position,
    ) -> Result<f64, PlanningError> {
        let [one, next] = [one, next].map(rotary);
        let ways = between(&one, &next);
        self.over_poses([one].into_iter().chain(ways))
    }

    fn over_poses(&self, poses: impl IntoIterator<Item = Position>) -> Result<f64, PlanningError> {
        let max = self.top_z;
        let no_room = |needed| PlanningError::NoRoomAbove { needed, max };
        poses.into_iter().try_fold(self.min_z, |needed, pose| {
            Ok(needed.max(self.about.z_over_all(&pose, MARGIN).map_err(no_room)?))
        })
    }
}

fn rotary(position: &Position) -> Position {
    position.only(|axis| !axis.is_linear())
}

/// Rotary positions of the steps and, between them, on the straight path from one to the next.
fn rotary_poses(plan: &Plan) -> Vec<Position> {
    // A prompt has no position.
    let mut moving = plan.steps.iter().filter(|step| step.kind != StepKind::Prompt).peekable();
    let mut poses: Vec<Position> =
        moving.peek().map(|step| rotary(&step.from)).into_iter().collect();
    while let (Some(one), Some(next)) = (moving.next(), moving.peek()) {
        poses.extend(between(&rotary(&one.from), &rotary(&next.from)));
    }
    if poses.is_empty() { vec![Position::new()] } else { poses }
}

/// Positions after `one` up to and including `next`.
fn between(one: &Position, next: &Position) -> Vec<Position> {
    let farthest = next.iter().map(|(axis, to)| (to - one.at(axis)).abs()).fold(0.0_f64, f64::max);
    let count = (farthest / ROTARY_STRIDE).ceil() as u32;
    let at = |k: u32| {
        let share = f64::from(k) / f64::from(count);
        next.iter().map(|(axis, to)| (axis, one.at(axis) + share * (to - one.at(axis)))).collect()
    };
    (1..=count).map(at).collect()
}

fn z_travel(machine: &Machine) -> Result<(f64, f64), PlanningError> {
    let topology = machine.topology.clone();
    let missing = KinematicsError::NotInAxes { axis: Axis::Z, topology };
    let spec = machine.axes.get(&Axis::Z).ok_or(missing)?;
    Ok((spec.min, spec.max))
}
