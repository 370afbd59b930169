//! Two bodies on their way: how near they come, by halving the way as often as it takes.
//!
//! Over a part of the way, no point strays further from where it stands in the middle than
//! [`Carried::sweep`](crate::kinematics::Carried::sweep) says; what is further apart in the middle
//! does not meet on that part. Rotary axes move together with linear ones, straight in joint space,
//! and nothing between samples is left to chance.

use super::body::Body;
use super::gap::{Across, gap};
use crate::kinematics::Commands;

/// The smallest clearance of a step is found to within this, mm.
const FOUND_WITHIN: f64 = 0.02;
/// What is nearer than this on the way counts as met, mm.
const RESOLUTION: f64 = 1e-3;

/// A straight motion in joint space.
#[derive(Debug, Clone, Copy)]
pub struct Way {
    pub from: Commands,
    pub to: Commands,
}

impl Way {
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
    let (bounds_one, bounds_other) = (one.shape.bounds(), other.shape.bounds());
    let mut nearest = demand.nearest;
    // Middle and half-length of the parts still to be looked at.
    let mut parts = vec![(0.5, 0.5)];
    while let Some((at, share)) = parts.pop() {
        let (middle, half) = (way.middle(at), way.half(share));
        let (one_at, stray_one) = one.carried.sweep(&middle, &half, bounds_one.0, bounds_one.1);
        let (other_at, stray_other) =
            other.carried.sweep(&middle, &half, bounds_other.0, bounds_other.1);
        let stray = stray_one + stray_other;
        let enough = demand.need.max(nearest - FOUND_WITHIN) + stray;
        let centres = one_at
            .transform_point3(bounds_one.0)
            .distance(other_at.transform_point3(bounds_other.0));
        let loose = demand.grown + demand.across.map_or(0.0, |across| across.by);
        if centres - bounds_one.1 - bounds_other.1 - loose > enough {
            continue;
        }
        let (one_at, other_at) = (one.shape.placed(&one_at), other.shape.placed(&other_at));
        let clearance =
            gap(&one_at, &other_at, demand.across, enough + demand.grown) - demand.grown;
        if clearance <= demand.need || (stray < RESOLUTION && clearance - stray <= demand.need) {
            return Err(clearance);
        }
        nearest = nearest.min(clearance);
        if clearance <= enough && stray >= RESOLUTION {
            parts.extend([(at + share / 2.0, share / 2.0), (at - share / 2.0, share / 2.0)]);
        }
    }
    Ok((nearest < demand.nearest).then_some(nearest))
}
