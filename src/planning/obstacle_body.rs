//! Convex bodies about the tool, in machine directions, and a check of their distance.

use machine::artefact::BodyShape;
use machine::frame::unit_vector;
use machine::record::machine::Solid;
use nalgebra::{Rotation3, Vector3};

use super::gjk::{SupportMapping, candidate_separating_directions, gap_of_supporting_planes_mm};

/// Height of the tool cylinder, mm: greater than the height of any machine.
const TOOL_CYLINDER_HEIGHT_MM: f64 = 2000.0;

/// Space that a part of the tool occupies on a straight path: a cylinder along Z without an upper end. If a body
/// is clear of it, it is also clear of the straight descent to the path, and of any higher path.
#[derive(Debug, Clone, Copy)]
pub(super) struct SweptToolSpace {
    /// Centres of the lower end, at the start and the end of the path.
    pub bottom_centre_path_ends: [Vector3<f64>; 2],
    pub radius: f64,
}

/// A body that does not move with the tool.
#[derive(Debug, Clone)]
pub(super) enum ObstacleBody {
    BallOrCylinder(BodyShape),
    /// Corners of a box.
    Box(Vec<Vector3<f64>>),
}

impl ObstacleBody {
    /// A cylinder if the solid states a radius, otherwise a box.
    pub fn from_solid(solid: &Solid) -> Self {
        let (from, to) = (Vector3::from(solid.from_mm), Vector3::from(solid.to_mm));
        match solid.radius_mm {
            Some(radius) => ObstacleBody::BallOrCylinder(BodyShape::Cylinder { from, to, radius }),
            None => Self::cuboid(solid.from_mm, solid.to_mm),
        }
    }

    /// A box between two opposite corners.
    pub fn cuboid(one: [f64; 3], other: [f64; 3]) -> Self {
        let [x, y, z] = [0, 1, 2].map(|axis| [one[axis], other[axis]]);
        let plane = |x| y.into_iter().flat_map(move |y| z.map(|z| Vector3::new(x, y, z)));
        Self::Box(x.into_iter().flat_map(plane).collect())
    }

    /// The body rotated about the origin.
    pub fn rotated(&self, by: &Rotation3<f64>) -> Self {
        match self {
            Self::Box(corners) => Self::Box(corners.iter().map(|corner| *by * *corner).collect()),
            ObstacleBody::BallOrCylinder(BodyShape::Ball { centre, radius }) => {
                ObstacleBody::BallOrCylinder(BodyShape::Ball { centre: *by * *centre, radius: *radius })
            }
            ObstacleBody::BallOrCylinder(BodyShape::Cylinder { from, to, radius }) => {
                let (from, to) = (*by * *from, *by * *to);
                ObstacleBody::BallOrCylinder(BodyShape::Cylinder { from, to, radius: *radius })
            }
        }
    }

    pub fn top_z(&self) -> f64 {
        match self {
            ObstacleBody::BallOrCylinder(shape) => shape.max_extent_along(Vector3::z()),
            Self::Box(corners) => corners.iter().map(|p| p.z).fold(f64::NEG_INFINITY, f64::max),
        }
    }

    /// Points and a radius: the body lies in the convex hull of the balls about the points.
    pub fn hull_points_and_radius(&self) -> (Vec<Vector3<f64>>, f64) {
        match self {
            ObstacleBody::BallOrCylinder(BodyShape::Ball { centre, radius }) => (vec![*centre], *radius),
            ObstacleBody::BallOrCylinder(BodyShape::Cylinder { from, to, radius }) => (vec![*from, *to], *radius),
            Self::Box(corners) => (corners.clone(), 0.0),
        }
    }
}

/// Farthest of the points along `direction`.
fn farthest_point(points: &[Vector3<f64>], direction: Vector3<f64>) -> Vector3<f64> {
    let further = |best: Vector3<f64>, next: &Vector3<f64>| {
        if next.dot(&direction) > best.dot(&direction) { *next } else { best }
    };
    points.iter().fold(points.first().copied().unwrap_or_default(), further)
}

impl SupportMapping for ObstacleBody {
    fn support(&self, direction: Vector3<f64>) -> Vector3<f64> {
        match self {
            Self::Box(corners) => farthest_point(corners, direction),
            ObstacleBody::BallOrCylinder(BodyShape::Ball { centre, radius }) => {
                *centre + *radius * unit_vector(direction).unwrap_or_default()
            }
            ObstacleBody::BallOrCylinder(BodyShape::Cylinder { from, to, radius }) => {
                let axis = unit_vector(*to - *from).unwrap_or_default();
                let out = unit_vector(direction - axis * axis.dot(&direction)).unwrap_or_default();
                farthest_point(&[*from, *to], direction) + *radius * out
            }
        }
    }
}

impl SupportMapping for SweptToolSpace {
    fn support(&self, direction: Vector3<f64>) -> Vector3<f64> {
        let out = unit_vector(Vector3::new(direction.x, direction.y, 0.0)).unwrap_or_default();
        let up = if direction.z > 0.0 { TOOL_CYLINDER_HEIGHT_MM } else { 0.0 };
        farthest_point(&self.bottom_centre_path_ends, direction) + self.radius * out + Vector3::z() * up
    }
}

/// Whether tool and body are at least `distance` apart, mm; false if this cannot be proven.
pub(super) fn are_apart_by(tool: &SweptToolSpace, body: &ObstacleBody, distance: f64) -> bool {
    candidate_separating_directions(tool, body, -Vector3::z(), f64::MAX)
        .into_iter()
        .any(|direction| gap_of_supporting_planes_mm(tool, body, direction) >= distance)
}
