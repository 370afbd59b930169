//! Lower bound of the distance between two convex bodies.
//!
//! The gap between two supporting planes is a lower bound of the distance, whatever the result of GJK.

use nalgebra::Vector3;

use machine::frame::{Pose, unit_vector};

use crate::gjk::{candidate_separating_directions, gap_of_supporting_planes_mm};

use super::body::ShapeInMachineFrame;

/// Possible misplacement of one body relative to the other, only perpendicular to a unit vector.
#[derive(Debug, Clone, Copy)]
pub struct LateralMisplacement {
    /// Unit vector, machine frame.
    pub perpendicular_to: Vector3<f64>,
    pub max_misplacement_mm: f64,
}

/// Lower bound of the distance, mm, and its direction: a unit vector from `one` to `other`. Not above 0 if the
/// bodies intersect.
#[derive(Debug, Clone, Copy)]
pub struct BodyGap {
    /// The possible lateral misplacement is already subtracted; negative infinity if a pose is not finite.
    pub distance_lower_bound_mm: f64,
    pub direction: Vector3<f64>,
}

/// Computes the gap, first across `direction_hint` (`None`: the line of the centres). The search ends when the gap
/// exceeds `sufficient_mm` for its direction; `max_sufficient_mm` is the maximum of `sufficient_mm` over all
/// directions.
pub fn compute_body_gap(
    one: &ShapeInMachineFrame,
    other: &ShapeInMachineFrame,
    direction_hint: Option<Vector3<f64>>,
    lateral: Option<LateralMisplacement>,
    sufficient_mm: impl Fn(Vector3<f64>) -> f64,
    max_sufficient_mm: f64,
) -> BodyGap {
    let (a, b) = (&one.machine_from_core, &other.machine_from_core);
    let is_finite = |pose: &Pose| pose.to_homogeneous().iter().all(|value| value.is_finite());
    if !(is_finite(a) && is_finite(b)) {
        return BodyGap { distance_lower_bound_mm: f64::NEG_INFINITY, direction: Vector3::x() };
    }
    let rounding_radius = one.rounding_radius + other.rounding_radius;
    let between = |direction: Vector3<f64>| {
        let off = lateral
            .map_or(0.0, |lateral| lateral.max_misplacement_mm * direction.cross(&lateral.perpendicular_to).norm());
        BodyGap {
            distance_lower_bound_mm: gap_of_supporting_planes_mm(one, other, direction) - off - rounding_radius,
            direction,
        }
    };
    let wider = |a: BodyGap, b: BodyGap| if b.distance_lower_bound_mm > a.distance_lower_bound_mm { b } else { a };
    let line = b.translation.vector - a.translation.vector;
    let start = direction_hint.unwrap_or(unit_vector(line).unwrap_or(Vector3::x()));
    let first = between(start);
    if first.distance_lower_bound_mm > sufficient_mm(start) {
        return first;
    }
    let widest = if max_sufficient_mm.is_finite() { max_sufficient_mm + rounding_radius } else { f64::MAX };
    candidate_separating_directions(one, other, start, widest).into_iter().map(between).fold(first, wider)
}
