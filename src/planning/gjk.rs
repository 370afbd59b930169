//! Whether two convex bodies are apart: parry's GJK proposes directions, and the planes across them
//! decide. So a search that did not converge costs a false refusal, never a collision.

use machine::frame::unit_vector;
use nalgebra::Vector3;
use parry3d_f64::math::{Pose, Vector};
use parry3d_f64::query::gjk::{CsoPoint, GJKResult, VoronoiSimplex, closest_points};
use parry3d_f64::shape::SupportMap;

/// A convex body.
pub(super) trait Support {
    /// Its farthest point along `direction`, which need not be of length 1.
    fn support(&self, direction: Vector3<f64>) -> Vector3<f64>;
}

struct InParry<'a, T>(&'a T);

impl<T: Support> SupportMap for InParry<'_, T> {
    fn local_support_point(&self, direction: Vector) -> Vector {
        self.0.support(direction.into()).into()
    }
}

/// A lower bound of the distance between `one` and `other`, mm: the gap between the two supporting
/// planes across `direction`, a unit vector from the one to the other.
pub(super) fn gap_across(one: &impl Support, other: &impl Support, direction: Vector3<f64>) -> f64 {
    direction.dot(&(other.support(-direction) - one.support(direction)))
}

/// Unit vectors from the one to the other across which the gap may be the widest; none where the
/// two meet. The search begins across `start` and ends once they are known to be `enough` apart, mm.
pub(super) fn directions(
    one: &impl Support,
    other: &impl Support,
    start: Vector3<f64>,
    enough: f64,
) -> Vec<Vector3<f64>> {
    let (one, other) = (InParry(one), InParry(other));
    let mut simplex = VoronoiSimplex::new();
    simplex.reset(CsoPoint::from_shapes(&Pose::IDENTITY, &one, &other, start.into()));
    let found = match closest_points(&Pose::IDENTITY, &one, &other, enough, true, &mut simplex) {
        GJKResult::Intersection => vec![],
        // Away from an edge the line between the two points is the better direction.
        GJKResult::ClosestPoints(p, q, direction) => vec![direction, q - p],
        GJKResult::Proximity(direction) | GJKResult::NoIntersection(direction) => vec![direction],
    };
    // Only across a vector of length 1 is the gap a bound.
    found.into_iter().filter_map(|direction| unit_vector(direction.into())).collect()
}
