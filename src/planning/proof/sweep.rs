//! Smallest distance of two bodies during a motion, found by repeated bisection of the path.
//!
//! During a part of the path, no point moves farther from its position in the middle than
//! [`CarrierMotion::sweep`](machine::kinematics::Going::sweep) states. If the bodies are farther apart than that in the
//! middle, they do not meet during that part. Without rotation, a direction that separates two bodies separates
//! them along the whole path, and one evaluation is often enough. Rotary axes move together with linear axes,
//! straight in joint space, and the bound also covers the positions between the evaluated ones.

use nalgebra::{Point3, Vector3};

use super::body::Body;
use super::gap::{Across, gap};
use machine::Axis;
use machine::frame::unit_vector;
use machine::kinematics::{CarrierMotion, Commands};

/// Accuracy of the smallest clearance of a step, mm.
pub(super) const FOUND_WITHIN: f64 = 0.02;
/// Distance below which two bodies count as colliding, mm.
const RESOLUTION: f64 = 1e-3;

/// A straight motion in joint space.
#[derive(Debug, Clone, Copy)]
pub struct Way {
    pub from: Commands,
    pub to: Commands,
}

impl Way {
    /// Whether a rotary axis or the spindle moves.
    pub fn turns(&self) -> bool {
        Axis::ALL.iter().any(|axis| !axis.is_linear() && self.moves(*axis))
    }

    fn moves(&self, axis: Axis) -> bool {
        self.from[axis as usize] != self.to[axis as usize]
    }

    fn middle(&self, at: f64) -> Commands {
        std::array::from_fn(|i| self.from[i] + at * (self.to[i] - self.from[i]))
    }

    fn half(&self, share: f64) -> Commands {
        std::array::from_fn(|i| share * (self.to[i] - self.from[i]).abs())
    }
}

/// Clearance requirement for two bodies.
#[derive(Debug, Clone, Copy)]
pub struct Demand {
    /// Minimum distance of the bodies, mm.
    pub need: f64,
    /// Position uncertainty of one body in all directions, mm.
    pub grown: f64,
    /// Position uncertainty across one direction only.
    pub across: Option<Across>,
    /// Clearances above this value are ignored, mm.
    pub nearest: f64,
}

/// Returns the smallest clearance, mm, if it is below `demand.nearest`.
///
/// # Errors
/// The clearance, mm, if the bodies come within `demand.need` or cannot be proven not to.
pub fn sweep(way: &Way, one: &Body, other: &Body, demand: &Demand) -> Result<Option<f64>, f64> {
    let bounds = (one.shape.bounds(), other.shape.bounds());
    let reaches = bounds.0.1 + bounds.1.1;
    let loose = demand.grown + demand.across.map_or(0.0, |across| across.by);
    let straight = straight(way, one, other);
    let mut nearest = demand.nearest;
    // Middle and half-length of the parts that are not evaluated yet.
    let mut parts = vec![(0.5, 0.5)];
    let mut hint = straight.map(|goes| {
        let at_end = |body: &Body, (centre, _): (Vector3<f64>, f64)| {
            body.carried.pose(&way.to).transform_point(&centre.into()).coords
        };
        let end = at_end(other, bounds.1) - at_end(one, bounds.0);
        unit_vector(nearest_origin(end - goes, end)).unwrap_or(Vector3::x())
    });
    let [one_goes, other_goes] = [one, other].map(|body| body.carried.going(&way.from, &way.to));
    while let Some((at, share)) = parts.pop() {
        let (middle, half) = (way.middle(at), way.half(share));
        let sweep = |body: &Body, goes: &CarrierMotion| {
            let (corners, radius) = &body.corners;
            goes.sweep(&middle, &half, corners, *radius)
        };
        let (one_at, one_stray) = sweep(one, &one_goes);
        let (other_at, other_stray) = sweep(other, &other_goes);
        let stray = one_stray + other_stray;
        let wanted = demand.need.max(nearest - FOUND_WITHIN);
        let [here, there] = [bounds.0, bounds.1].map(|(centre, _)| Point3::from(centre));
        let centres = nalgebra::distance(&(one_at * here), &(other_at * there));
        if centres - reaches - loose > wanted + stray {
            continue;
        }
        let (one_at, other_at) = (one.shape.placed(&one_at), other.shape.placed(&other_at));
        // Without rotation, the gap across one direction changes linearly along the path.
        let change = |direction: Vector3<f64>| {
            straight.map_or(stray, |goes| share * goes.dot(&direction).abs())
        };
        let wide = wanted + demand.grown;
        let enough = (|direction| wide + change(direction), wide + stray);
        let found = gap(&one_at, &other_at, hint, demand.across, enough);
        hint = Some(found.direction);
        let clearance = found.mm - demand.grown;
        let change = change(found.direction);
        if clearance <= demand.need || (stray < RESOLUTION && clearance - change <= demand.need) {
            return Err(clearance);
        }
        nearest = nearest.min(clearance);
        if clearance - change <= wanted && stray >= RESOLUTION {
            parts.extend([(at + share / 2.0, share / 2.0), (at - share / 2.0, share / 2.0)]);
        }
    }
    Ok((nearest < demand.nearest).then_some(nearest))
}

/// Displacement of the other body relative to the first, mm, machine frame; `None` if either rotates.
fn straight(way: &Way, one: &Body, other: &Body) -> Option<Vector3<f64>> {
    let turns = |body: &Body| body.carried.axes().any(|axis| !axis.is_linear() && way.moves(axis));
    let goes = |body: &Body| {
        body.carried.pose(&way.to).translation.vector
            - body.carried.pose(&way.from).translation.vector
    };
    (!turns(one) && !turns(other)).then(|| goes(other) - goes(one))
}

/// Point nearest to the origin on the straight line between two points.
pub(super) fn nearest_origin(from: Vector3<f64>, to: Vector3<f64>) -> Vector3<f64> {
    let goes = to - from;
    let square = goes.norm_squared();
    let share = if square > 0.0 { (-from.dot(&goes) / square).clamp(0.0, 1.0) } else { 0.0 };
    from + share * goes
}
