//! How high Z must stand so that everything else may move.

use glam::{DAffine3, DVec3};

use super::PlanningError;
use crate::artefact;
use crate::base::{Axis, Point, Position, Spindle};
use crate::kinematics::{Chain, KinematicsError, Side};
use crate::record::artefact::Artefact;
use crate::record::machine::{Carrier, Machine, Solid};
use crate::record::plan::Plan;

/// Free distance between the stylus ball and the highest point of the part, mm.
const MARGIN: f64 = 10.0;
/// Rotary axes are looked at this often on their way, rad.
const ROTARY_STRIDE: f64 = 5.0 * std::f64::consts::PI / 180.0;

/// Z commands, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clearance {
    /// At or above it the stylus ball, and with it all that is higher, passes over the part and over
    /// every solid and kept-out box that Z can pass over, at every rotary position of the plan and on
    /// the way between them.
    pub safe_z: f64,
    /// The upper end of Z, where the first block goes if nobody knows where the machine stands.
    pub top_z: f64,
}

impl Clearance {
    /// Above the artefact of `plan` as its steps turn it, with a margin of 10 mm and the declared
    /// uncertainty of its place. A solid so high that Z ends below it does not count: whether the way
    /// leads past it is for the proof to say.
    ///
    /// # Errors
    /// Z ends below that height, or goes down on a positive command; a machine without kinematics.
    pub fn above(plan: &Plan) -> Result<Self, PlanningError> {
        let machine = &plan.machine;
        let seeker = Seeker {
            chain: Chain::new(machine)?,
            tip: Point::from_vec(DVec3::from_array(machine.tool_mm)),
            artefact: &plan.artefact,
        };
        let free = MARGIN + plan.probe.ball_radius_mm + artefact::uncertainty_mm(&plan.artefact);
        let zero = Position::new();
        if seeker.z_over(&zero, free + 1.0)? < seeker.z_over(&zero, free)? {
            return Err(PlanningError::ZDown);
        }
        let (min, max) = z_travel(machine)?;
        let neighbours = neighbours(plan);
        let mut needed = f64::NEG_INFINITY;
        for pose in rotary_poses(plan) {
            needed = needed.max(seeker.z_over(&pose, free)?);
            for solid in &neighbours {
                let top = seeker.top_of(solid, &pose) + MARGIN + plan.probe.ball_radius_mm;
                let over = seeker.z_at(&pose, top)?;
                needed = if over > max { needed } else { needed.max(over) };
            }
        }
        if needed > max {
            return Err(PlanningError::NoRoomAbove { needed, max });
        }
        Ok(Self { safe_z: needed.max(min), top_z: max })
    }
}

struct Seeker<'a> {
    chain: Chain,
    tip: Point<Spindle>,
    artefact: &'a Artefact,
}

impl Seeker<'_> {
    /// Z command that holds the ball centre `free` above the highest point of the artefact.
    fn z_over(&self, pose: &Position, free: f64) -> Result<f64, PlanningError> {
        let table = self.chain.machine_from_table(pose, &[]);
        self.z_at(pose, highest(self.artefact, &table) + free)
    }

    /// Height of the highest point of a solid in the machine frame, mm.
    fn top_of(&self, solid: &Solid, pose: &Position) -> f64 {
        let Some(carried) = self.chain.carried(solid.on) else { return f64::NEG_INFINITY };
        let commands = Axis::ALL.map(|axis| pose.at(axis));
        let frame = carried.pose(&commands);
        let (from, to) = (DVec3::from_array(solid.from_mm), DVec3::from_array(solid.to_mm));
        let up = frame.matrix3.transpose() * DVec3::Z;
        let highest = match solid.radius_mm {
            Some(radius) => {
                let axis = (to - from).normalize_or_zero();
                from.dot(up).max(to.dot(up)) + radius * (up - axis * axis.dot(up)).length()
            }
            None => (from * up).max(to * up).element_sum(),
        };
        frame.translation.z + highest
    }

    /// Z command that holds the ball centre at a height in the machine frame.
    fn z_at(&self, pose: &Position, height: f64) -> Result<f64, PlanningError> {
        let table = self.chain.machine_from_table(pose, &[]);
        let ball = self.chain.machine_from_spindle(pose, &[]).transform_point3(self.tip.mm);
        let over = DVec3::new(ball.x, ball.y, height);
        let target = Point::from_vec(table.inverse().transform_point3(over));
        Ok(self.chain.linear_axes_for(target, self.tip, pose, &[])?.at(Axis::Z))
    }
}

/// Height of the highest point of the artefact in the machine frame, mm.
fn highest(artefact: &Artefact, table: &DAffine3) -> f64 {
    let up = table.matrix3.transpose() * DVec3::Z;
    let tops = artefact::parts(artefact).into_iter().map(|part| part.shape.highest(up));
    table.translation.z + tops.fold(f64::NEG_INFINITY, f64::max)
}

/// What the tool may have to pass over, beside the artefact. Kept-out boxes stand on the bed.
fn neighbours(plan: &Plan) -> Vec<Solid> {
    let boxes = plan.keepout.iter().map(|keepout| Solid {
        name: keepout.name.clone(),
        on: Carrier::Bed,
        from_mm: keepout.min_mm,
        to_mm: keepout.max_mm,
        radius_mm: None,
    });
    let chain = Chain::new(&plan.machine).ok();
    let side = |on| chain.as_ref()?.carried(on).map(|carried| carried.side());
    let beside = plan.solids.iter().filter(|solid| side(solid.on) != Some(Side::Tool));
    beside.cloned().chain(boxes).collect()
}

/// Rotary positions of the steps and, between them, on the straight way from one to the next.
fn rotary_poses(plan: &Plan) -> Vec<Position> {
    let rotary = |position: &Position| position.only(|axis| !axis.is_linear());
    let mut poses: Vec<Position> =
        plan.steps.first().map_or_else(Vec::new, |step| vec![rotary(&step.from)]);
    for pair in plan.steps.windows(2) {
        if let [one, next] = pair {
            poses.extend(between(&rotary(&one.from), &rotary(&next.from)));
        }
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
