//! Lower bound of the distance between two convex bodies.
//!
//! The gap between two supporting planes is a lower bound of the distance, whatever the result of GJK.

use nalgebra::Vector3;

use machine::frame::{Pose, unit_vector};

use crate::gjk::{directions, gap_across};

use super::body::Placed;

/// Uncertainty of the relative position of the bodies: up to `by`, mm, across the unit vector `along`.
#[derive(Debug, Clone, Copy)]
pub struct Across {
    pub along: Vector3<f64>,
    pub by: f64,
}

/// Lower bound of the distance, mm, and its direction: a unit vector from `one` to `other`. Not above 0 if the
/// bodies intersect.
#[derive(Debug, Clone, Copy)]
pub struct Gap {
    pub mm: f64,
    pub direction: Vector3<f64>,
}

/// Computes the gap, first across `hint`. The search ends when the gap exceeds `enough` for its direction; `most`
/// is the maximum of `enough` over all directions.
pub fn gap(
    one: &Placed,
    other: &Placed,
    hint: Option<Vector3<f64>>,
    across: Option<Across>,
    (enough, most): (impl Fn(Vector3<f64>) -> f64, f64),
) -> Gap {
    let (a, b) = (&one.machine_from_core, &other.machine_from_core);
    let is_finite = |pose: &Pose| pose.to_homogeneous().iter().all(|value| value.is_finite());
    if !(is_finite(a) && is_finite(b)) {
        return Gap { mm: f64::NEG_INFINITY, direction: Vector3::x() };
    }
    let round = one.round + other.round;
    let between = |direction: Vector3<f64>| {
        let off = across.map_or(0.0, |across| across.by * direction.cross(&across.along).norm());
        Gap { mm: gap_across(one, other, direction) - off - round, direction }
    };
    let wider = |a: Gap, b: Gap| if b.mm > a.mm { b } else { a };
    let line = b.translation.vector - a.translation.vector;
    let start = hint.unwrap_or(unit_vector(line).unwrap_or(Vector3::x()));
    let first = between(start);
    if first.mm > enough(start) {
        return first;
    }
    let widest = if most.is_finite() { most + round } else { f64::MAX };
    directions(one, other, start, widest).into_iter().map(between).fold(first, wider)
}
