//! All bodies of a plan, and which of them could meet.

use glam::DVec3;

use super::body::{Body, Shape};
use super::refusal::Reason;
use crate::base::Axis;
use crate::kinematics::{Carried, Chain, Side};
use crate::record::machine::{Artefact, Carrier};
use crate::record::plan::Plan;

/// Index of the artefact and of the stylus ball among the bodies.
const ARTEFACT: usize = 0;
const BALL: usize = 1;

pub struct Scene {
    pub bodies: Vec<Body>,
    pub pairs: Vec<Pair>,
    /// How far the artefact may be from where it is thought to be.
    pub uncertainty: f64,
    pub not_declared: Vec<String>,
}

/// Two bodies that could meet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    pub one: usize,
    pub other: usize,
    pub meets: Meets,
}

/// What a pair is to a touch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Meets {
    /// The ball and the artefact: they are meant to.
    Touch,
    /// What rides with the ball, and the artefact.
    Beside,
    /// All others.
    Never,
}

impl Scene {
    /// `artefact` as it is to be looked at.
    pub fn new(plan: &Plan, artefact: &Artefact) -> Result<Self, Reason> {
        let chain = Chain::new(&plan.machine)?;
        let mut builder = Builder { chain, bodies: Vec::new() };
        let Artefact::Cylinder { centre_mm, axis, radius_mm, height_mm, uncertainty_mm } = artefact;
        let foot = DVec3::from_array(*centre_mm);
        let top = foot + DVec3::from_array(*axis).normalize_or(DVec3::Z) * *height_mm;
        builder.add("artefact", Carrier::Table, Shape::cylinder(foot, top, *radius_mm))?;
        let not_declared = builder.probe(plan)?;
        for keepout in &plan.keepout {
            let [low, high] = [keepout.min_mm, keepout.max_mm].map(DVec3::from_array);
            builder.add(&keepout.name, Carrier::Bed, Shape::cuboid(low, high))?;
        }
        for solid in &plan.solids {
            builder.add(&solid.name, solid.on, Shape::solid(solid))?;
        }
        let pairs = pairs(&builder.bodies);
        Ok(Self { bodies: builder.bodies, pairs, uncertainty: *uncertainty_mm, not_declared })
    }

    pub fn artefact(&self) -> &Body {
        &self.bodies[ARTEFACT]
    }

    pub fn ball(&self) -> &Body {
        &self.bodies[BALL]
    }

    /// How far the bodies of a pair may stand nearer to each other than they are thought to.
    pub fn grown(&self, pair: &Pair) -> f64 {
        if pair.one == ARTEFACT || pair.other == ARTEFACT { self.uncertainty } else { 0.0 }
    }
}

struct Builder {
    chain: Chain,
    bodies: Vec<Body>,
}

impl Builder {
    fn add(&mut self, name: &str, carrier: Carrier, shape: Shape) -> Result<(), Reason> {
        let missing = || match carrier {
            Carrier::Axis(axis) => Reason::Carrier { solid: name.to_owned(), axis },
            _ => Reason::NoStep,
        };
        let carried = self.chain.carried(carrier).ok_or_else(missing)?;
        let corners = shape.corners();
        self.bodies.push(Body { name: name.to_owned(), shape, carried, corners });
        Ok(())
    }

    /// Ball, stem and body of the probe, which turn with the spindle. Returns what is not declared.
    fn probe(&mut self, plan: &Plan) -> Result<Vec<String>, Reason> {
        let probe = &plan.probe;
        let ball = DVec3::from_array(plan.machine.tool_mm);
        let turns = self.chain.topology().contains(Axis::S);
        let on = if turns { Carrier::Axis(Axis::S) } else { Carrier::Spindle };
        self.add("stylus ball", on, Shape::ball(ball, probe.ball_radius_mm))?;
        let end = ball + DVec3::Z * probe.stem_length_mm;
        let top = end + DVec3::Z * probe.body_length_mm;
        let parts = [
            ("stylus stem", ball, end, probe.stem_radius_mm),
            ("probe body", end, top, probe.body_radius_mm),
        ];
        let mut missing = Vec::new();
        for (name, from, to, radius) in parts {
            if radius > 0.0 && from != to {
                self.add(name, on, Shape::cylinder(from, to, radius))?;
            } else {
                missing.push(name.to_owned());
            }
        }
        let solid_on = |side: Side| {
            let carried = |on| self.chain.carried(on).map(|carried| carried.side());
            plan.solids.iter().any(|solid| carried(solid.on) == Some(side))
        };
        for (name, side) in [("spindle nose", Side::Tool), ("table", Side::Work)] {
            if !solid_on(side) {
                missing.push(name.to_owned());
            }
        }
        Ok(missing)
    }
}

/// Tool side against everything else, workpiece side against the bed; of the others, neither or
/// both move with the same axes.
fn pairs(bodies: &[Body]) -> Vec<Pair> {
    let mut pairs = Vec::new();
    for (one, a) in bodies.iter().enumerate() {
        for (other, b) in bodies.iter().enumerate() {
            let sides = (a.carried.side(), b.carried.side());
            let apart = sides.1 == Side::Bed && sides.0 == Side::Work
                || sides.0 == Side::Tool && sides.1 != Side::Tool;
            let meets = if other != ARTEFACT {
                Meets::Never
            } else if one == BALL {
                Meets::Touch
            } else if rides_with(&a.carried, bodies.get(BALL)) {
                Meets::Beside
            } else {
                Meets::Never
            };
            if apart {
                pairs.push(Pair { one, other, meets });
            }
        }
    }
    pairs
}

/// The spindle's turn apart, the same linear and rotary axes move it as the ball.
fn rides_with(carried: &Carried, ball: Option<&Body>) -> bool {
    let axes = |carried: &Carried| -> Vec<Axis> {
        carried.axes().filter(|axis| *axis != Axis::S).collect()
    };
    ball.is_some_and(|ball| axes(&ball.carried) == axes(carried))
}
