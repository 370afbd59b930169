//! The body that a touch meets, the length of the touch, and the bodies that may come near.
//!
//! The body is somewhere within its uncertainty, but the stylus ball stops at its *actual* position. An offset
//! along the touch shifts contact and all parts that move with the ball alike; an offset across the touch does not.
//! Therefore stem, probe body and all other parts on the spindle are checked as far as the ball gets when that body
//! is offset across the touch in any direction. They are checked against the body (and its stem, which moves with
//! it) enlarged across the touch. Against everything else, including the other balls of an artefact, the touch is
//! checked over its full length.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use super::body::{Body, Shape};
use super::gap::Across;
use super::refusal::Reason;
use super::scene::Scene;
use super::sweep::Way;
use machine::frame::{Pose, across, unit_vector};
use machine::kinematics::Commands;

/// Maximum distance between contact and trigger, mm.
const PRE_TRAVEL: f64 = 0.1;
/// Number of directions across the touch in which the artefact is shifted.
const SHIFTS: u32 = 8;
const HALVINGS: u32 = 40;
/// Maximum angle between the expected contact with a ball and the normal of the step, degrees.
const AIM_DEG: f64 = 25.0;
/// Rounding tolerance of the text, mm.
const ROUNDING: f64 = 2e-3;

/// Part of a touch that contact allows.
pub struct Reach {
    /// Number of the touched body.
    pub body: usize,
    pub way: Way,
    pub across: Across,
}

/// Straight path of the stylus ball in the frame of the artefact: only linear axes move, whether or not they carry
/// the table.
struct Line {
    table: Pose,
    from: Vector3<f64>,
    to: Vector3<f64>,
    along: Vector3<f64>,
    radius: f64,
}

/// Finds the body that the ball meets first when all bodies are at their assumed positions: this is the touched
/// body. `braking`: braking distance from the touch's feed, mm; `normal`: of the surface at the expected contact,
/// machine frame.
///
/// # Errors
/// The ball meets no body before the end of the path, or would miss a ball at some position within its uncertainty,
/// or meets it on another side than the step states.
pub fn reach(scene: &Scene, way: &Way, braking: f64, normal: [f64; 3]) -> Result<Reach, Reason> {
    let line = Line::new(scene, way).ok_or(Reason::NoContact)?;
    let met = scene.touched().filter_map(|(number, body)| {
        Some((number, body, line.contact(&body.shape, Vector3::zeros())?))
    });
    let (number, body, at) = met.min_by(|a, b| a.2.total_cmp(&b.2)).ok_or(Reason::NoContact)?;
    if let Some(ball) = body.shape.as_ball() {
        line.meets_wherever(body, ball, scene.uncertainty)?;
        line.is_aimed(body, ball.0, at, Vector3::from(normal))?;
    }
    let farthest = line.farthest(&body.shape, at, scene.uncertainty);
    let end = (farthest + (PRE_TRAVEL + braking) / line.from.metric_distance(&line.to)).min(1.0);
    let stop = std::array::from_fn(|i| way.from[i] + end * (way.to[i] - way.from[i]));
    let across = Across { along: line.table.rotation * line.along, by: scene.uncertainty };
    Ok(Reach { body: number, way: Way { from: way.from, to: stop }, across })
}

impl Line {
    fn new(scene: &Scene, way: &Way) -> Option<Self> {
        let (_, artefact) = scene.touched().next()?;
        let tip = scene.ball()?;
        let (centre, radius) = tip.shape.bounds();
        let ball_at = |commands: &Commands| {
            let table = artefact.carried.pose(commands);
            let tool = tip.carried.pose(commands);
            table.inverse_transform_point(&tool.transform_point(&centre.into())).coords
        };
        let (from, to) = (ball_at(&way.from), ball_at(&way.to));
        let along = unit_vector(to - from)?;
        Some(Self { table: artefact.carried.pose(&way.from), from, to, along, radius })
    }

    fn at(&self, share: f64) -> Vector3<f64> {
        self.from + share * (self.to - self.from)
    }

    /// Position of the ball, as a share of the path, at which it meets a shape that is displaced by `shift`.
    fn contact(&self, shape: &Shape, shift: Vector3<f64>) -> Option<f64> {
        first_contact(|share| shape.distance(self.at(share) - shift) - self.radius)
    }

    /// Latest contact with a shape that is displaced across the path; `straight`: contact without displacement.
    fn farthest(&self, shape: &Shape, straight: f64, uncertainty: f64) -> f64 {
        let [right, up] = across(self.along);
        // Contact is a convex function of the displacement: the corners of a polygon around the circle bound it.
        let corner = uncertainty / (TAU / f64::from(2 * SHIFTS)).cos();
        (0..SHIFTS).fold(straight, |farthest, k| {
            let (sin, cos) = (TAU * f64::from(k) / f64::from(SHIFTS)).sin_cos();
            let shifted = self.contact(shape, corner * (cos * right + sin * up));
            farthest.max(shifted.unwrap_or(1.0))
        })
    }

    /// Checks that the touch meets the ball at every possible position: all possible positions of its centre are
    /// within the round-ended rod that the touch sweeps.
    fn meets_wherever(
        &self,
        body: &Body,
        (centre, radius): (Vector3<f64>, f64),
        uncertainty: f64,
    ) -> Result<(), Reason> {
        let ahead =
            (centre - self.from).dot(&self.along).clamp(0.0, self.from.metric_distance(&self.to));
        let apart = centre.metric_distance(&(self.from + ahead * self.along));
        if apart <= radius + self.radius - uncertainty + ROUNDING {
            return Ok(());
        }
        Err(Reason::Misses { body: body.name.clone(), uncertainty })
    }

    fn is_aimed(
        &self,
        body: &Body,
        centre: Vector3<f64>,
        at: f64,
        normal: Vector3<f64>,
    ) -> Result<(), Reason> {
        let meant = self.table.rotation.inverse() * normal;
        let out = self.at(at) - centre;
        // Without a normal, the value is NaN, and the touch is refused.
        let cos = out.dot(&meant) / (out.norm() * meant.norm());
        let off = cos.clamp(-1.0, 1.0).acos().to_degrees();
        if off <= AIM_DEG {
            return Ok(());
        }
        Err(Reason::NotAimed { body: body.name.clone(), off })
    }
}

/// Share of the path at which a distance becomes zero; the distance is convex over the path and positive at its
/// beginning. `None` if it is positive at the end.
fn first_contact(free: impl Fn(f64) -> f64) -> Option<f64> {
    if free(1.0) > 0.0 {
        return None;
    }
    let (mut clear, mut met) = (0.0, 1.0);
    for _ in 0..HALVINGS {
        let middle = (clear + met) / 2.0;
        if free(middle) > 0.0 { clear = middle } else { met = middle }
    }
    Some(met)
}
