//! Convex bodies, each on its carrier.

use nalgebra::{Rotation3, Translation3, Vector3};
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::{Cuboid, Cylinder, SupportMap};

use machine::artefact::{self, ArtefactBody};
use machine::frame::{Pose, perpendicular_directions, unit_vector};
use machine::kinematics::CarrierChain;
use machine::record::machine::Solid;

use crate::gjk::SupportMapping;

/// A shape without its rounding radius. The axis of a cylinder is Y, as in parry.
#[derive(Debug, Clone, Copy)]
enum ShapeCore {
    Point,
    Cylinder(Cylinder),
    Box(Cuboid),
}

/// A shape in its carrier's frame, mm.
#[derive(Debug, Clone, Copy)]
pub struct CollisionShape {
    core: ShapeCore,
    /// Rounding radius: all points within this distance of the core belong to the shape. 0 except for a ball.
    rounding_radius: f64,
    carrier_from_core: Pose,
}

impl CollisionShape {
    /// A ball. All points that a constructor of this type takes are in the frame of the carrier.
    pub fn ball(centre: Vector3<f64>, radius: f64) -> Self {
        let carrier_from_core = Pose::from(Translation3::from(centre));
        Self { core: ShapeCore::Point, rounding_radius: radius, carrier_from_core }
    }

    /// A cylinder between the centres of its end faces.
    pub fn cylinder(from: Vector3<f64>, to: Vector3<f64>, radius: f64) -> Self {
        let axis = unit_vector(to - from).unwrap_or(Vector3::y());
        let [right, up] = perpendicular_directions(axis);
        let turned = Rotation3::from_basis_unchecked(&[up, axis, right]);
        Self {
            core: ShapeCore::Cylinder(Cylinder::new(from.metric_distance(&to) / 2.0, radius)),
            rounding_radius: 0.0,
            carrier_from_core: Pose::from_parts(Translation3::from((from + to) / 2.0), turned),
        }
    }

    /// A box between two opposite corners.
    pub fn cuboid(one: Vector3<f64>, other: Vector3<f64>) -> Self {
        Self {
            core: ShapeCore::Box(Cuboid::new(((one - other).abs() / 2.0).into())),
            rounding_radius: 0.0,
            carrier_from_core: Pose::from(Translation3::from((one + other) / 2.0)),
        }
    }

    pub fn from_artefact_body(part: &ArtefactBody) -> Self {
        match part.shape {
            artefact::BodyShape::Ball { centre, radius } => Self::ball(centre, radius),
            artefact::BodyShape::Cylinder { from, to, radius } => Self::cylinder(from, to, radius),
        }
    }

    /// A cylinder if the solid states a radius, otherwise a box.
    pub fn from_solid(solid: &Solid) -> Self {
        let (from, to) = (Vector3::from(solid.from_mm), Vector3::from(solid.to_mm));
        match solid.radius_mm {
            Some(radius) => Self::cylinder(from, to, radius),
            None => Self::cuboid(from, to),
        }
    }

    /// Centre (carrier frame) and radius, if the shape is a ball.
    pub fn ball_centre_and_radius(&self) -> Option<(Vector3<f64>, f64)> {
        let ball = matches!(self.core, ShapeCore::Point);
        ball.then_some((self.carrier_from_core.translation.vector, self.rounding_radius))
    }

    /// Bounding ball of the shape, carrier frame.
    pub fn bounding_ball(&self) -> (Vector3<f64>, f64) {
        let radius = match self.core {
            ShapeCore::Point => 0.0,
            ShapeCore::Cylinder(cylinder) => cylinder.half_height.hypot(cylinder.radius),
            ShapeCore::Box(cuboid) => cuboid.half_extents.length(),
        };
        (self.carrier_from_core.translation.vector, radius + self.rounding_radius)
    }

    /// Points and a radius: the shape lies in the convex hull of the balls about the points, carrier frame.
    pub fn hull_points_and_radius(&self) -> (Vec<Vector3<f64>>, f64) {
        let (points, radius) = match self.core {
            ShapeCore::Point => (vec![Vector3::zeros()], 0.0),
            ShapeCore::Cylinder(cylinder) => {
                let end = Vector3::y() * cylinder.half_height;
                (vec![end, -end], cylinder.radius)
            }
            ShapeCore::Box(cuboid) => {
                let signs = [-1.0, 1.0];
                let corner = |x, y, z| Vector3::from(cuboid.half_extents).component_mul(&Vector3::new(x, y, z));
                let all = signs.iter().flat_map(|x| signs.iter().map(move |y| (*x, *y)));
                (all.flat_map(|(x, y)| signs.map(|z| corner(x, y, z))).collect(), 0.0)
            }
        };
        let placed = points.into_iter().map(|p| self.carrier_from_core.transform_point(&p.into()).coords);
        (placed.collect(), radius + self.rounding_radius)
    }

    /// Distance of a point (carrier frame) from the shape; 0 inside.
    pub fn distance_to_point(&self, point: Vector3<f64>) -> f64 {
        let local = self.carrier_from_core.inverse_transform_point(&point.into()).coords;
        let distance = match self.core {
            ShapeCore::Point => local.norm(),
            ShapeCore::Cylinder(cylinder) => cylinder.distance_to_local_point(local.into(), true),
            ShapeCore::Box(cuboid) => cuboid.distance_to_local_point(local.into(), true),
        };
        (distance - self.rounding_radius).max(0.0)
    }

    pub fn in_machine_frame(&self, machine_from_carrier: &Pose) -> ShapeInMachineFrame {
        let machine_from_core = *machine_from_carrier * self.carrier_from_core;
        ShapeInMachineFrame { core: self.core, rounding_radius: self.rounding_radius, machine_from_core }
    }
}

/// A shape in the machine frame.
pub struct ShapeInMachineFrame {
    core: ShapeCore,
    /// All points within this distance of the core belong to the shape.
    pub rounding_radius: f64,
    pub machine_from_core: Pose,
}

/// Support of the core; the gap subtracts the rounding radius.
impl SupportMapping for ShapeInMachineFrame {
    fn support(&self, direction: Vector3<f64>) -> Vector3<f64> {
        let local = self.machine_from_core.inverse_transform_vector(&direction);
        let point = match self.core {
            ShapeCore::Point => Vector3::zeros(),
            ShapeCore::Cylinder(cylinder) => cylinder.local_support_point(local.into()).into(),
            ShapeCore::Box(cuboid) => cuboid.local_support_point(local.into()).into(),
        };
        self.machine_from_core.transform_point(&point.into()).coords
    }
}

/// Role of a body in a touch. The touched bodies of the artefact are numbered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum BodyRole {
    /// Body of the artefact that a touch may meet.
    Touchable(usize),
    /// Stem that carries a touched body and moves with it.
    StemOfTouchable(usize),
    /// Part of the artefact that is neither touched nor the stem of a touched body.
    OtherArtefactPart,
    /// A datum cylinder, which displacement sensors measure.
    DatumCylinder,
    /// The body of a displacement sensor in the spindle or on the bed.
    SpindleOrBedSensor,
    /// The body of a displacement sensor on the table, which measures the stylus ball.
    TableSensor {
        /// Gap between ball and sensor at the near end of the range, mm; limited to 0 to
        /// [`super::MIN_UNGUARDED_CLEARANCE_MM`].
        min_gap_mm: f64,
    },
    StylusBall,
    /// Stem of the stylus: the probe detects contact with it as well.
    StylusStem,
    /// Probe body, solid or keep-out box.
    OtherBody,
}

/// A body that nothing else may collide with.
#[derive(Debug, Clone)]
pub struct CollisionBody {
    pub name: String,
    pub role: BodyRole,
    pub shape: CollisionShape,
    /// Chain of axes that moves the carrier of the body. In a pair, without the axes that both bodies share.
    pub carrier_chain: CarrierChain,
    /// Points and a radius: the shape lies in the convex hull of the balls about the points, carrier frame.
    pub hull_points_and_radius: (Vec<Vector3<f64>>, f64),
}
