//! Smallest distance of two bodies during a motion, found by repeated bisection of the path.
//!
//! During a part of the path, no point moves farther from its position in the middle than
//! [`CarrierMotion::pose_and_displacement_bound`] states. If the bodies are farther apart than that in the
//! middle, they do not meet during that part. Without rotation, a direction that separates two bodies separates
//! them along the whole path, and one evaluation is often enough. Rotary axes move together with linear axes,
//! straight in joint space, and the bound also covers the positions between the evaluated ones.

use nalgebra::{Point3, Vector3};

use super::body::CollisionBody;
use super::body_gap::{LateralMisplacement, compute_body_gap};
use machine::Axis;
use machine::frame::unit_vector;
use machine::kinematics::{AxisCommands, CarrierMotion};

/// Maximum amount by which the reported smallest clearance of a step may exceed the true one, mm.
pub(super) const REPORTED_CLEARANCE_ACCURACY_MM: f64 = 0.02;
/// Displacement during a part of the path below which the part is not bisected further, mm: bodies that are not proven
/// clear then count as colliding.
const MIN_BISECTED_DISPLACEMENT_MM: f64 = 1e-3;

/// A straight motion in joint space; commands of all axes, mm or rad.
#[derive(Debug, Clone, Copy)]
pub struct JointPath {
    pub from: AxisCommands,
    pub to: AxisCommands,
}

impl JointPath {
    /// Whether a rotary axis or the spindle moves.
    pub fn moves_rotary_axis(&self) -> bool {
        Axis::ALL.iter().any(|axis| !axis.is_linear() && self.moves_axis(*axis))
    }

    fn moves_axis(&self, axis: Axis) -> bool {
        self.from[axis as usize] != self.to[axis as usize]
    }

    /// Commands at this share of the path: 0 at `from`, 1 at `to`.
    pub fn commands_at_share(&self, at: f64) -> AxisCommands {
        std::array::from_fn(|i| self.from[i] + at * (self.to[i] - self.from[i]))
    }

    /// Absolute distance of each axis over this share (0 to 1) of the path.
    fn axis_distances_of_share(&self, share: f64) -> AxisCommands {
        std::array::from_fn(|i| share * (self.to[i] - self.from[i]).abs())
    }
}

/// Clearance requirement for two bodies.
#[derive(Debug, Clone, Copy)]
pub struct ClearanceDemand {
    /// Minimum distance of the bodies, mm.
    pub required_clearance_mm: f64,
    /// Maximum misplacement of one body, in any direction, mm.
    pub max_misplacement_mm: f64,
    /// Possible misplacement perpendicular to one direction only.
    pub lateral_misplacement: Option<LateralMisplacement>,
    /// Clearances above this value are ignored, mm.
    pub ignored_above_mm: f64,
}

impl ClearanceDemand {
    /// Demand on two bodies of which neither is touched; every clearance counts.
    pub fn without_upper_bound(required_clearance_mm: f64, max_misplacement_mm: f64) -> Self {
        let ignored_above_mm = f64::INFINITY;
        Self { required_clearance_mm, max_misplacement_mm, lateral_misplacement: None, ignored_above_mm }
    }
}

/// Returns the smallest clearance, mm, if it is below `demand.ignored_above_mm`.
///
/// # Errors
/// The clearance, mm, if the bodies come within `demand.required_clearance_mm` or cannot be proven not to.
pub fn check_min_clearance_on_path(
    joint_path: &JointPath,
    one: &CollisionBody,
    other: &CollisionBody,
    demand: &ClearanceDemand,
) -> Result<Option<f64>, f64> {
    let bounds = (one.shape.bounding_ball(), other.shape.bounding_ball());
    let reaches = bounds.0.1 + bounds.1.1;
    let uncertainty_mm =
        demand.max_misplacement_mm + demand.lateral_misplacement.map_or(0.0, |lateral| lateral.max_misplacement_mm);
    let relative_translation = relative_translation(joint_path, one, other);
    let mut nearest = demand.ignored_above_mm;
    // Middle and half-length of the parts that are not evaluated yet.
    let mut parts = vec![(0.5, 0.5)];
    let mut direction_hint = relative_translation.map(|goes| {
        let at_end = |body: &CollisionBody, (centre, _): (Vector3<f64>, f64)| {
            body.carrier_chain.pose(&joint_path.to).transform_point(&centre.into()).coords
        };
        let end = at_end(other, bounds.1) - at_end(one, bounds.0);
        unit_vector(segment_point_nearest_to_origin(end - goes, end)).unwrap_or(Vector3::x())
    });
    let [one_goes, other_goes] =
        [one, other].map(|body| body.carrier_chain.motion_between(&joint_path.from, &joint_path.to));
    while let Some((at, share)) = parts.pop() {
        let (middle, half) = (joint_path.commands_at_share(at), joint_path.axis_distances_of_share(share));
        let sweep = |body: &CollisionBody, goes: &CarrierMotion| {
            let (corners, radius) = &body.hull_points_and_radius;
            goes.pose_and_displacement_bound(&middle, &half, corners, *radius)
        };
        let (one_at, one_stray) = sweep(one, &one_goes);
        let (other_at, other_stray) = sweep(other, &other_goes);
        let stray = one_stray + other_stray;
        let required_mm = demand.required_clearance_mm.max(nearest - REPORTED_CLEARANCE_ACCURACY_MM);
        let [here, there] = [bounds.0, bounds.1].map(|(centre, _)| Point3::from(centre));
        let centres = nalgebra::distance(&(one_at * here), &(other_at * there));
        if centres - reaches - uncertainty_mm > required_mm + stray {
            continue;
        }
        let (one_at, other_at) = (one.shape.in_machine_frame(&one_at), other.shape.in_machine_frame(&other_at));
        // Without rotation, the gap across one direction changes linearly along the path.
        let change =
            |direction: Vector3<f64>| relative_translation.map_or(stray, |goes| share * goes.dot(&direction).abs());
        let wide = required_mm + demand.max_misplacement_mm;
        let enough = |direction| wide + change(direction);
        let nearest_gap =
            compute_body_gap(&one_at, &other_at, direction_hint, demand.lateral_misplacement, enough, wide + stray);
        direction_hint = Some(nearest_gap.direction);
        let guaranteed_clearance_mm = nearest_gap.distance_lower_bound_mm - demand.max_misplacement_mm;
        let change = change(nearest_gap.direction);
        if guaranteed_clearance_mm <= demand.required_clearance_mm
            || (stray < MIN_BISECTED_DISPLACEMENT_MM
                && guaranteed_clearance_mm - change <= demand.required_clearance_mm)
        {
            return Err(guaranteed_clearance_mm);
        }
        nearest = nearest.min(guaranteed_clearance_mm);
        if guaranteed_clearance_mm - change <= required_mm && stray >= MIN_BISECTED_DISPLACEMENT_MM {
            parts.extend([(at + share / 2.0, share / 2.0), (at - share / 2.0, share / 2.0)]);
        }
    }
    Ok((nearest < demand.ignored_above_mm).then_some(nearest))
}

/// Displacement of the other body relative to the first, mm, machine frame; `None` if either rotates.
fn relative_translation(joint_path: &JointPath, one: &CollisionBody, other: &CollisionBody) -> Option<Vector3<f64>> {
    let turns =
        |body: &CollisionBody| body.carrier_chain.axes().any(|axis| !axis.is_linear() && joint_path.moves_axis(axis));
    let goes = |body: &CollisionBody| {
        body.carrier_chain.pose(&joint_path.to).translation.vector
            - body.carrier_chain.pose(&joint_path.from).translation.vector
    };
    (!turns(one) && !turns(other)).then(|| goes(other) - goes(one))
}

/// Point nearest to the origin on the straight line between two points.
pub(super) fn segment_point_nearest_to_origin(from: Vector3<f64>, to: Vector3<f64>) -> Vector3<f64> {
    let goes = to - from;
    let square = goes.norm_squared();
    let share = if square > 0.0 { (-from.dot(&goes) / square).clamp(0.0, 1.0) } else { 0.0 };
    from + share * goes
}
