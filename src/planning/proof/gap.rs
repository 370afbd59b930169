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

/// A lower bound of the distance, mm, and the direction across which it is one: unit vector from
/// the one to the other. Not above 0 where the bodies meet.
#[derive(Debug, Clone, Copy)]
pub struct Gap {
    pub mm: f64,
    pub direction: DVec3,
}

/// Looked for first across `hint`, and not more closely once it is above what is `enough` across
/// that direction; in no direction is more than `most` enough.
pub fn gap(
    one: &Placed,
    other: &Placed,
    hint: Option<DVec3>,
    across: Option<Across>,
    (enough, most): (impl Fn(DVec3) -> f64, f64),
) -> Gap {
    let (a, b) = (&one.machine_from_core, &other.machine_from_core);
    if !(a.is_finite() && b.is_finite()) {
        return Gap { mm: f64::NEG_INFINITY, direction: DVec3::X };
    }
    let round = one.round + other.round;
    let between = |direction: DVec3| {
        let planes = direction.dot(other.local_support_point(-direction))
            - direction.dot(one.local_support_point(direction));
        let off =
            across.map_or(0.0, |across| across.by * direction.reject_from(across.along).length());
        Gap { mm: planes - off - round, direction }
    };
    let wider = |a: Gap, b: Gap| if b.mm > a.mm { b } else { a };
    let start = hint.unwrap_or((b.translation - a.translation).normalize_or(DVec3::X));
    let first = between(start);
    if first.mm > enough(start) {
        return first;
    }
    let mut simplex = VoronoiSimplex::new();
    simplex.reset(CsoPoint::from_shapes(&Pose::IDENTITY, one, other, start));
    let widest = if most.is_finite() { most + round } else { f64::MAX };
    match closest_points(&Pose::IDENTITY, one, other, widest, true, &mut simplex) {
        GJKResult::Intersection => first,
        // Away from an edge the line between the two points is the better direction.
        GJKResult::ClosestPoints(p, q, direction) => {
            let line = (q - p).normalize_or(direction);
            wider(first, wider(between(direction), between(line)))
        }
        GJKResult::Proximity(direction) | GJKResult::NoIntersection(direction) => {
            wider(first, between(direction))
        }
    }
}
