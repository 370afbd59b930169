//! Which body a touch is to meet, how far it goes, and what may come near that body on the way.
//!
//! The body stands somewhere within its uncertainty, but the ball stops where *it* stands: what is
//! off along the touch shifts contact and everything that rides with the ball alike. What is off
//! across it does not. So stem, probe body and whatever else rides on the spindle are looked at as
//! far as the ball gets with that body off across the touch to any side, against the body (and its
//! stem, which rides with it) grown across the touch; for everything else, the other balls of an
//! artefact among it, the touch goes its full length.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use super::body::{Body, Shape};
use super::gap::Across;
use super::refusal::Reason;
use super::scene::Scene;
use super::sweep::Way;
use machine::frame::{Pose, across, unit_vector};
use machine::kinematics::Commands;

/// The trigger comes within this after contact, mm.
const PRE_TRAVEL: f64 = 0.1;
/// Directions across the touch in which the artefact is shifted.
const SHIFTS: u32 = 8;
const HALVINGS: u32 = 40;
/// Contact with a ball must be expected this near to where the step's normal says, degrees.
const AIM_DEG: f64 = 25.0;
/// Rounding of the text, mm.
const ROUNDING: f64 = 2e-3;

/// As far as contact lets the ball go.
pub struct Reach {
    /// The body that is meant, by its number.
    pub body: usize,
    pub way: Way,
    pub across: Across,
}

/// The stylus ball's straight way as the artefact sees it: linear axes alone move, however the table
/// goes itself.
struct Line {
    table: Pose,
    from: Vector3<f64>,
    to: Vector3<f64>,
    along: Vector3<f64>,
    radius: f64,
}

/// The body that the ball meets first where all stand as they are thought to is the one that is
/// meant. `braking`: way from the touch's feed to rest, mm; `normal`: of the surface where the step
/// expects contact, machine frame.
///
/// # Errors
/// The ball reaches none before the way ends, or not wherever a ball may stand; or another side of
/// it than the step says.
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

    /// Where the ball meets a shape that stands off by `shift`.
    fn contact(&self, shape: &Shape, shift: Vector3<f64>) -> Option<f64> {
        first_contact(|share| shape.distance(self.at(share) - shift) - self.radius)
    }

    /// The latest contact with a shape that is off across the way; `straight`: if it is not.
    fn farthest(&self, shape: &Shape, straight: f64, uncertainty: f64) -> f64 {
        let [right, up] = across(self.along);
        // Contact comes the later the more convex: the corners around the circle bound all of it.
        let corner = uncertainty / (TAU / f64::from(2 * SHIFTS)).cos();
        (0..SHIFTS).fold(straight, |farthest, k| {
            let (sin, cos) = (TAU * f64::from(k) / f64::from(SHIFTS)).sin_cos();
            let shifted = self.contact(shape, corner * (cos * right + sin * up));
            farthest.max(shifted.unwrap_or(1.0))
        })
    }

    /// All points that the ball's centre may have lie within the round-ended rod that the touch
    /// sweeps: then it meets the ball wherever that stands.
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
        // Without a direction to compare with it is not a number, and the touch not aimed.
        let cos = out.dot(&meant) / (out.norm() * meant.norm());
        let off = cos.clamp(-1.0, 1.0).acos().to_degrees();
        if off <= AIM_DEG {
            return Ok(());
        }
        Err(Reason::NotAimed { body: body.name.clone(), off })
    }
}

/// Where a distance that is convex over the way, and positive at its beginning, becomes zero;
/// `None` if it is positive at the end.
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
