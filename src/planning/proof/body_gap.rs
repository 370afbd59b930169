//! Lower bound of the distance between two convex bodies.
//!
//! The gap between two supporting planes is a lower bound of the distance, whatever the result of GJK.

use nalgebra::Vector3;

use machine::frame::{Pose, unit_vector};

use crate::gjk::{gap_across_mm, separating_directions};

use super::body::MachineShape;

/// Uncertainty of the relative position of the bodies: up to `amount_mm`, mm, across the unit vector `direction`.
#[derive(Debug, Clone, Copy)]
pub struct LateralUncertainty {
    pub direction: Vector3<f64>,
    pub amount_mm: f64,
}

/// Lower bound of the distance, mm, and its direction: a unit vector from `one` to `other`. Not above 0 if the
/// bodies intersect.
#[derive(Debug, Clone, Copy)]
pub struct BodyGap {
    pub distance_mm: f64,
    pub direction: Vector3<f64>,
}

/// Computes the gap, first across `direction_hint`. The search ends when the gap exceeds `sufficient_mm` for its
/// direction; `max_sufficient_mm` is the maximum of `sufficient_mm` over all directions.
pub fn body_gap(
    one: &MachineShape,
    other: &MachineShape,
    direction_hint: Option<Vector3<f64>>,
    lateral: Option<LateralUncertainty>,
    sufficient_mm: impl Fn(Vector3<f64>) -> f64,
    max_sufficient_mm: f64,
) -> BodyGap {
    let (a, b) = (&one.machine_from_core, &other.machine_from_core);
    let is_finite = |pose: &Pose| pose.to_homogeneous().iter().all(|value| value.is_finite());
    if !(is_finite(a) && is_finite(b)) {
        return BodyGap { distance_mm: f64::NEG_INFINITY, direction: Vector3::x() };
    }
    let rounding_radius = one.rounding_radius + other.rounding_radius;
    let between = |direction: Vector3<f64>| {
        let off = lateral.map_or(0.0, |lateral| lateral.amount_mm * direction.cross(&lateral.direction).norm());
        BodyGap { distance_mm: gap_across_mm(one, other, direction) - off - rounding_radius, direction }
    };
    let wider = |a: BodyGap, b: BodyGap| if b.distance_mm > a.distance_mm { b } else { a };
    let line = b.translation.vector - a.translation.vector;
    let start = direction_hint.unwrap_or(unit_vector(line).unwrap_or(Vector3::x()));
    let first = between(start);
    if first.distance_mm > sufficient_mm(start) {
        return first;
    }
    let widest = if max_sufficient_mm.is_finite() { max_sufficient_mm + rounding_radius } else { f64::MAX };
    separating_directions(one, other, start, widest).into_iter().map(between).fold(first, wider)
}
