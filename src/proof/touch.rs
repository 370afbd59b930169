//! How far a touch goes, and what may come near the artefact on the way.
//!
//! The artefact stands somewhere within its uncertainty, but the ball stops where *it* stands: what
//! is off along the touch shifts contact and everything that rides with the ball alike. What is off
//! across it does not. So stem, body and whatever else rides on the spindle are looked at as far as
//! the ball gets with the artefact off across the touch to any side, against the artefact grown
//! across the touch; for everything else the touch goes its full length.

use std::f64::consts::TAU;

use glam::DVec3;

use super::gap::Across;
use super::scene::Scene;
use super::sweep::Way;
use crate::kinematics::Commands;

/// The trigger comes within this after contact, mm.
const PRE_TRAVEL: f64 = 0.1;
/// Directions across the touch in which the artefact is shifted.
const SHIFTS: u32 = 8;
const HALVINGS: u32 = 40;

/// As far as contact lets the ball go.
pub struct Reach {
    pub way: Way,
    pub across: Across,
}

/// `braking`: way from the touch's feed to rest, mm. `None`: the ball does not reach the artefact
/// where it is thought to be before the way ends.
pub fn reach(scene: &Scene, way: &Way, braking: f64) -> Option<Reach> {
    let table = scene.artefact().carried.pose(&way.from);
    let (centre, radius) = scene.ball().shape.bounds();
    // Linear axes alone move: in the artefact's frame the ball goes straight, however the table
    // goes itself.
    let ball_at = |commands: &Commands| {
        let table = scene.artefact().carried.pose(commands);
        let tool = scene.ball().carried.pose(commands);
        table.matrix3.transpose() * (tool.transform_point3(centre) - table.translation)
    };
    let (from, to) = (ball_at(&way.from), ball_at(&way.to));
    let along = (to - from).try_normalize()?;
    let contact = |shift: DVec3| {
        let free = |at: f64| {
            let ball = from + at * (to - from) - shift;
            scene.artefact().shape.distance(ball) - radius
        };
        first_contact(free)
    };
    let mut farthest = contact(DVec3::ZERO)?;
    let (right, up) = along.any_orthonormal_pair();
    for k in 0..SHIFTS {
        // Contact comes the later the more convex: the corners around the circle bound all of it.
        let (sin, cos) = (TAU * f64::from(k) / f64::from(SHIFTS)).sin_cos();
        let corner = scene.uncertainty / (TAU / f64::from(2 * SHIFTS)).cos();
        let shifted = contact(corner * (cos * right + sin * up));
        farthest = farthest.max(shifted.unwrap_or(1.0));
    }
    let end = (farthest + (PRE_TRAVEL + braking) / from.distance(to)).min(1.0);
    let stop = std::array::from_fn(|i| way.from[i] + end * (way.to[i] - way.from[i]));
    let across = Across { along: table.matrix3 * along, by: scene.uncertainty };
    Some(Reach { way: Way { from: way.from, to: stop }, across })
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
