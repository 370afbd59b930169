//! Separation of two convex bodies. The GJK algorithm of `parry3d` only proposes directions; the proof of separation is
//! the gap between the supporting planes across a direction. If GJK does not converge, a free motion may be refused,
//! but a collision is never accepted.

use machine::frame::unit_vector;
use nalgebra::Vector3;
use parry3d_f64::math::{Pose, Vector};
use parry3d_f64::query::gjk::{CsoPoint, GJKResult, VoronoiSimplex, closest_points};
use parry3d_f64::shape::SupportMap;

/// A convex body.
pub(super) trait SupportMapping {
    /// Farthest point of the body along `direction`, which need not have length 1.
    fn support(&self, direction: Vector3<f64>) -> Vector3<f64>;
}

struct ParryShape<'a, T>(&'a T);

impl<T: SupportMapping> SupportMap for ParryShape<'_, T> {
    fn local_support_point(&self, direction: Vector) -> Vector {
        self.0.support(direction.into()).into()
    }
}

/// Lower bound of the distance between `one` and `other`, mm: the gap between the two supporting planes across
/// `direction`, a unit vector from `one` to `other`.
pub(super) fn gap_of_supporting_planes_mm(
    one: &impl SupportMapping,
    other: &impl SupportMapping,
    direction: Vector3<f64>,
) -> f64 {
    direction.dot(&(other.support(-direction) - one.support(direction)))
}

/// Unit vectors from `one` to `other` across which the gap may be the widest; none if the bodies intersect. The
/// search begins across `start` and ends when the distance is known to be at least `sufficient_mm`, mm.
pub(super) fn candidate_separating_directions(
    one: &impl SupportMapping,
    other: &impl SupportMapping,
    start: Vector3<f64>,
    sufficient_mm: f64,
) -> Vec<Vector3<f64>> {
    let (one, other) = (ParryShape(one), ParryShape(other));
    let mut simplex = VoronoiSimplex::new();
    simplex.reset(CsoPoint::from_shapes(&Pose::IDENTITY, &one, &other, start.into()));
    let found = match closest_points(&Pose::IDENTITY, &one, &other, sufficient_mm, true, &mut simplex) {
        GJKResult::Intersection => vec![],
        // Away from an edge, the line between the two points is the better direction.
        GJKResult::ClosestPoints(p, q, direction) => vec![direction, q - p],
        GJKResult::Proximity(direction) | GJKResult::NoIntersection(direction) => {
            vec![direction]
        }
    };
    // `gap_of_supporting_planes_mm` is a lower bound of the distance only for a unit vector.
    found.into_iter().filter_map(|direction| unit_vector(direction.into())).collect()
}
