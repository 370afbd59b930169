//! Convex bodies about the tool, machine directions, and whether they stand far enough apart.

use glam::{DMat3, DVec3};
use parry3d_f64::math::Pose;
use parry3d_f64::query::gjk::{CsoPoint, GJKResult, VoronoiSimplex, closest_points};
use parry3d_f64::shape::SupportMap;

use machine::artefact::Shape;
use machine::record::machine::Solid;

/// Higher than any machine, mm.
const ENDLESS: f64 = 2000.0;

/// A part of the tool on a straight way: an upright cylinder without an upper end. Whatever it is
/// clear of, it was clear of on its way straight down; and higher up it is clear of more.
#[derive(Debug, Clone, Copy)]
pub(super) struct Upright {
    /// Middles of its lower end, first and last.
    pub way: [DVec3; 2],
    pub radius: f64,
}

/// A body that does not move with the tool.
#[derive(Debug, Clone)]
pub(super) enum Body {
    Round(Shape),
    /// Corners.
    Box(Vec<DVec3>),
}

impl Body {
    pub fn of(solid: &Solid) -> Self {
        let (from, to) = (DVec3::from_array(solid.from_mm), DVec3::from_array(solid.to_mm));
        match solid.radius_mm {
            Some(radius) => Self::Round(Shape::Cylinder { from, to, radius }),
            None => Self::cuboid(solid.from_mm, solid.to_mm),
        }
    }

    /// Between two opposite corners.
    pub fn cuboid(one: [f64; 3], other: [f64; 3]) -> Self {
        let [x, y, z] = [0, 1, 2].map(|axis| [one[axis], other[axis]]);
        let plane = |x| y.into_iter().flat_map(move |y| z.map(|z| DVec3::new(x, y, z)));
        Self::Box(x.into_iter().flat_map(plane).collect())
    }

    pub fn turned(&self, by: &DMat3) -> Self {
        match self {
            Self::Box(corners) => Self::Box(corners.iter().map(|corner| *by * *corner).collect()),
            Self::Round(Shape::Ball { centre, radius }) => {
                Self::Round(Shape::Ball { centre: *by * *centre, radius: *radius })
            }
            Self::Round(Shape::Cylinder { from, to, radius }) => {
                let (from, to) = (*by * *from, *by * *to);
                Self::Round(Shape::Cylinder { from, to, radius: *radius })
            }
        }
    }

    pub fn top(&self) -> f64 {
        match self {
            Self::Round(shape) => shape.highest(DVec3::Z),
            Self::Box(corners) => corners.iter().map(|p| p.z).fold(f64::NEG_INFINITY, f64::max),
        }
    }

    /// Points and a radius about each, in whose hull it lies.
    pub fn points(&self) -> (Vec<DVec3>, f64) {
        match self {
            Self::Round(Shape::Ball { centre, radius }) => (vec![*centre], *radius),
            Self::Round(Shape::Cylinder { from, to, radius }) => (vec![*from, *to], *radius),
            Self::Box(corners) => (corners.clone(), 0.0),
        }
    }
}

/// Farthest of the points along a direction.
fn farthest(points: &[DVec3], direction: DVec3) -> DVec3 {
    let further = |best: DVec3, next: &DVec3| {
        if next.dot(direction) > best.dot(direction) { *next } else { best }
    };
    points.iter().fold(points.first().copied().unwrap_or_default(), further)
}

impl SupportMap for Body {
    fn local_support_point(&self, direction: DVec3) -> DVec3 {
        match self {
            Self::Box(corners) => farthest(corners, direction),
            Self::Round(Shape::Ball { centre, radius }) => {
                *centre + *radius * direction.normalize_or_zero()
            }
            Self::Round(Shape::Cylinder { from, to, radius }) => {
                let axis = (*to - *from).normalize_or_zero();
                let out = (direction - axis * axis.dot(direction)).normalize_or_zero();
                farthest(&[*from, *to], direction) + *radius * out
            }
        }
    }
}

impl SupportMap for Upright {
    fn local_support_point(&self, direction: DVec3) -> DVec3 {
        let out = DVec3::new(direction.x, direction.y, 0.0).normalize_or_zero();
        let up = if direction.z > 0.0 { ENDLESS } else { 0.0 };
        farthest(&self.way, direction) + self.radius * out + DVec3::Z * up
    }
}

/// Are the two at least so far apart? What cannot be shown counts as no: parry's GJK proposes a
/// direction, and the planes across it decide.
pub(super) fn apart_by(tool: &Upright, body: &Body, distance: f64) -> bool {
    let gap = |direction: DVec3| {
        let direction = direction.normalize_or_zero();
        (body.local_support_point(-direction) - tool.local_support_point(direction)).dot(direction)
    };
    let mut simplex = VoronoiSimplex::new();
    simplex.reset(CsoPoint::from_shapes(&Pose::IDENTITY, tool, body, DVec3::NEG_Z));
    match closest_points(&Pose::IDENTITY, tool, body, f64::MAX, true, &mut simplex) {
        GJKResult::Intersection => false,
        GJKResult::ClosestPoints(p, q, direction) => gap(direction).max(gap(q - p)) >= distance,
        GJKResult::Proximity(direction) | GJKResult::NoIntersection(direction) => {
            gap(direction) >= distance
        }
    }
}
