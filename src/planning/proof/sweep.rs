//! Two bodies on their way: how near they come, by halving the way as often as it takes.
//!
//! Over a part of the way, no point strays further from where it stands in the middle than
//! [`Going::sweep`](machine::kinematics::Going::sweep) says; what is further apart in the middle
//! does not meet on that part. Where nothing turns, what keeps two bodies apart across one direction
//! does so along the whole way, and one look is often enough. Rotary axes move together with linear
//! ones, straight in joint space, and nothing between samples is left to chance.

use nalgebra::{Point3, Vector3};

use super::body::Body;
use super::gap::{Across, gap};
use machine::Axis;
use machine::frame::unit_vector;
use machine::kinematics::{Commands, Going};

/// The smallest clearance of a step is found to within this, mm.
pub(super) const FOUND_WITHIN: f64 = 0.02;
/// What is nearer than this on the way counts as met, mm.
const RESOLUTION: f64 = 1e-3;

/// A straight motion in joint space.
#[derive(Debug, Clone, Copy)]
pub struct Way {
    pub from: Commands,
    pub to: Commands,
}

impl Way {
    /// Does a rotary axis or the spindle move?
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

/// What is asked of two bodies.
#[derive(Debug, Clone, Copy)]
pub struct Demand {
    /// They must stay further apart than this.
    pub need: f64,
    /// One of them may be nearer by this than it is thought to be: to all sides,
    pub grown: f64,
    /// or across a direction only.
    pub across: Option<Across>,
    /// Clearances above this are of no interest.
    pub nearest: f64,
}

/// The smallest clearance, mm, if it is below `demand.nearest`.
///
/// # Errors
/// They come within `demand.need`, as the value says, or cannot be shown not to.
pub fn sweep(way: &Way, one: &Body, other: &Body, demand: &Demand) -> Result<Option<f64>, f64> {
    let bounds = (one.shape.bounds(), other.shape.bounds());
    let reaches = bounds.0.1 + bounds.1.1;
    let loose = demand.grown + demand.across.map_or(0.0, |across| across.by);
    let straight = straight(way, one, other);
    let mut nearest = demand.nearest;
    // Middle and half-length of the parts still to be looked at.
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
        let sweep = |body: &Body, goes: &Going| {
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
        // Without turning, the gap across one direction changes evenly along the way.
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

/// How the other body goes as seen from the one, mm, machine frame; `None` if either turns.
fn straight(way: &Way, one: &Body, other: &Body) -> Option<Vector3<f64>> {
    let turns = |body: &Body| body.carried.axes().any(|axis| !axis.is_linear() && way.moves(axis));
    let goes = |body: &Body| {
        body.carried.pose(&way.to).translation.vector
            - body.carried.pose(&way.from).translation.vector
    };
    (!turns(one) && !turns(other)).then(|| goes(other) - goes(one))
}

/// The point nearest to the origin on the straight line between two points.
pub(super) fn nearest_origin(from: Vector3<f64>, to: Vector3<f64>) -> Vector3<f64> {
    let goes = to - from;
    let square = goes.norm_squared();
    let share = if square > 0.0 { (-from.dot(&goes) / square).clamp(0.0, 1.0) } else { 0.0 };
    from + share * goes
}
