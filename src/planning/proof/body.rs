//! Convex bodies, each on its carrier.

use glam::{DAffine3, DMat3, DVec3};
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::{Cuboid, Cylinder, SupportMap};

use machine::artefact::{self, Part};
use machine::kinematics::Carried;
use machine::record::machine::Solid;

/// A shape without its rounding. A cylinder's axis is Y, after parry.
#[derive(Debug, Clone, Copy)]
enum Core {
    Point,
    Cylinder(Cylinder),
    Box(Cuboid),
}

/// A shape in its carrier's frame, mm.
#[derive(Debug, Clone, Copy)]
pub struct Shape {
    core: Core,
    /// All points within this distance of the core belong to it.
    round: f64,
    carrier_from_core: DAffine3,
}

impl Shape {
    pub fn ball(centre: DVec3, radius: f64) -> Self {
        let carrier_from_core = DAffine3::from_translation(centre);
        Self { core: Core::Point, round: radius, carrier_from_core }
    }

    pub fn cylinder(from: DVec3, to: DVec3, radius: f64) -> Self {
        let axis = (to - from).normalize_or(DVec3::Y);
        let across = axis.any_orthonormal_vector();
        let turned = DMat3::from_cols(across, axis, across.cross(axis));
        Self {
            core: Core::Cylinder(Cylinder::new(from.distance(to) / 2.0, radius)),
            round: 0.0,
            carrier_from_core: DAffine3::from_mat3_translation(turned, (from + to) / 2.0),
        }
    }

    /// Between two opposite corners.
    pub fn cuboid(one: DVec3, other: DVec3) -> Self {
        Self {
            core: Core::Box(Cuboid::new((one - other).abs() / 2.0)),
            round: 0.0,
            carrier_from_core: DAffine3::from_translation((one + other) / 2.0),
        }
    }

    pub fn part(part: &Part) -> Self {
        match part.shape {
            artefact::Shape::Ball { centre, radius } => Self::ball(centre, radius),
            artefact::Shape::Cylinder { from, to, radius } => Self::cylinder(from, to, radius),
        }
    }

    pub fn solid(solid: &Solid) -> Self {
        let (from, to) = (DVec3::from_array(solid.from_mm), DVec3::from_array(solid.to_mm));
        match solid.radius_mm {
            Some(radius) => Self::cylinder(from, to, radius),
            None => Self::cuboid(from, to),
        }
    }

    /// Centre (carrier frame) and radius, if it is one.
    pub fn as_ball(&self) -> Option<(DVec3, f64)> {
        let ball = matches!(self.core, Core::Point);
        ball.then_some((self.carrier_from_core.translation, self.round))
    }

    /// A ball around all of it, carrier frame.
    pub fn bounds(&self) -> (DVec3, f64) {
        let radius = match self.core {
            Core::Point => 0.0,
            Core::Cylinder(cylinder) => cylinder.half_height.hypot(cylinder.radius),
            Core::Box(cuboid) => cuboid.half_extents.length(),
        };
        (self.carrier_from_core.translation, radius + self.round)
    }

    /// Points and a radius: it lies in the convex hull of the balls about them, carrier frame.
    pub fn corners(&self) -> (Vec<DVec3>, f64) {
        let (points, radius) = match self.core {
            Core::Point => (vec![DVec3::ZERO], 0.0),
            Core::Cylinder(cylinder) => {
                let end = DVec3::Y * cylinder.half_height;
                (vec![end, -end], cylinder.radius)
            }
            Core::Box(cuboid) => {
                let signs = [-1.0, 1.0];
                let corner = |x, y, z| cuboid.half_extents * DVec3::new(x, y, z);
                let all = signs.iter().flat_map(|x| signs.iter().map(move |y| (*x, *y)));
                (all.flat_map(|(x, y)| signs.map(|z| corner(x, y, z))).collect(), 0.0)
            }
        };
        let placed = points.into_iter().map(|p| self.carrier_from_core.transform_point3(p));
        (placed.collect(), radius + self.round)
    }

    /// Distance of a point (carrier frame) from it; 0 inside.
    pub fn distance(&self, point: DVec3) -> f64 {
        let frame = &self.carrier_from_core;
        let local = frame.matrix3.transpose() * (point - frame.translation);
        let distance = match self.core {
            Core::Point => local.length(),
            Core::Cylinder(cylinder) => cylinder.distance_to_local_point(local, true),
            Core::Box(cuboid) => cuboid.distance_to_local_point(local, true),
        };
        (distance - self.round).max(0.0)
    }

    pub fn placed(&self, machine_from_carrier: &DAffine3) -> Placed {
        let machine_from_core = *machine_from_carrier * self.carrier_from_core;
        Placed { core: self.core, round: self.round, machine_from_core }
    }
}

/// A shape in the machine frame.
pub struct Placed {
    core: Core,
    pub round: f64,
    pub machine_from_core: DAffine3,
}

/// Of the core: the rounding is taken off the distance.
impl SupportMap for Placed {
    fn local_support_point(&self, direction: DVec3) -> DVec3 {
        let local = self.machine_from_core.matrix3.transpose() * direction;
        let point = match self.core {
            Core::Point => DVec3::ZERO,
            Core::Cylinder(cylinder) => cylinder.local_support_point(local),
            Core::Box(cuboid) => cuboid.local_support_point(local),
        };
        self.machine_from_core.transform_point3(point)
    }
}

/// What a body is to a touch. Bodies of the artefact that are there to be touched are numbered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Role {
    Touched(usize),
    /// What a touched body stands on, and rides with: a stem.
    StemOf(usize),
    /// Of the artefact, neither touched nor the stem of one.
    Frame,
    StylusBall,
    /// It bends the stylus as well: the probe feels it.
    StylusStem,
    Other,
}

/// Something that nothing else may meet.
#[derive(Debug, Clone)]
pub struct Body {
    pub name: String,
    pub role: Role,
    pub shape: Shape,
    pub carried: Carried,
    /// [`Shape::corners`]
    pub corners: (Vec<DVec3>, f64),
}
