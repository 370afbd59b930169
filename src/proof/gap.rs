//! How far two convex bodies are apart, at least.
//!
//! parry's GJK proposes a direction; the gap between the two supporting planes across it is a lower
//! bound of the distance, whatever GJK has come to. So a search that did not converge costs a false
//! refusal, never a collision.

use glam::DVec3;
use parry3d_f64::math::Pose;
use parry3d_f64::query::gjk::{CsoPoint, GJKResult, VoronoiSimplex, closest_points};
use parry3d_f64::shape::SupportMap;

use super::body::Placed;

/// The bodies may be off by as much as `by` across the unit vector `along`.
#[derive(Debug, Clone, Copy)]
pub struct Across {
    pub along: DVec3,
    pub by: f64,
}

/// Lower bound of the distance, mm; not above 0 where the bodies meet. Not looked for more closely
/// once it is above `enough`.
pub fn gap(one: &Placed, other: &Placed, across: Option<Across>, enough: f64) -> f64 {
    let (a, b) = (&one.machine_from_core, &other.machine_from_core);
    if !(a.is_finite() && b.is_finite()) {
        return f64::NEG_INFINITY;
    }
    let round = one.round + other.round;
    let between = |direction: DVec3| {
        let planes = direction.dot(other.local_support_point(-direction))
            - direction.dot(one.local_support_point(direction));
        let off =
            across.map_or(0.0, |across| across.by * direction.reject_from(across.along).length());
        planes - off
    };
    let start = (b.translation - a.translation).normalize_or(DVec3::X);
    let first = between(start);
    if first - round > enough {
        return first - round;
    }
    let mut simplex = VoronoiSimplex::new();
    simplex.reset(CsoPoint::from_shapes(&Pose::IDENTITY, one, other, start));
    let widest = if enough.is_finite() { enough + round } else { f64::MAX };
    let found = closest_points(&Pose::IDENTITY, one, other, widest, true, &mut simplex);
    let proposed = match found {
        GJKResult::Intersection => first,
        // Away from an edge the line between the two points is the better direction.
        GJKResult::ClosestPoints(p, q, direction) => {
            let line = (q - p).normalize_or(direction);
            between(direction).max(between(line))
        }
        GJKResult::Proximity(direction) | GJKResult::NoIntersection(direction) => {
            between(direction)
        }
    };
    proposed.max(first) - round
}
