//! The nearest true surface along a straight line of sight.

use nalgebra::Vector3;

use super::machine_pose::MachinePose;
use super::nearest_surface::NearestSurface;
use super::ramp::first_crossing;
use super::surface::Surface;

/// The scene at one moment, as seen from the part that carries a sensor.
#[derive(Debug, Clone, Copy)]
pub(super) struct SensorView<'a> {
    /// Pose of the carrier, in place of the spindle.
    pub carrier_and_table: MachinePose,
    pub target: MeasuredObject<'a>,
    /// Growth of the radius of a round part, mm.
    pub growth: f64,
    pub t_s: f64,
}

/// Object that a sensor measures.
#[derive(Debug, Clone, Copy)]
pub(super) enum MeasuredObject<'a> {
    /// The artefact.
    Surface(&'a Surface),
    /// The sphere in the spindle; centre in the table frame, mm.
    Sphere { centre: Vector3<f64>, radius: f64 },
}

impl MeasuredObject<'_> {
    /// Nearest surface to `point` in the table frame.
    fn nearest(&self, point: Vector3<f64>, growth: f64, t_s: f64) -> NearestSurface {
        match self {
            Self::Surface(surface) => surface.nearest(point, growth, t_s),
            Self::Sphere { centre, radius } => {
                let from_centre = point - centre;
                let normal = from_centre.try_normalize(0.0).unwrap_or(Vector3::z());
                NearestSurface { distance: from_centre.norm() - radius, normal }
            }
        }
    }
}

/// End point of a line of sight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SurfaceHit {
    /// Distance from the line's origin, mm.
    pub distance: f64,
    /// Outward unit normal of the surface there, spindle frame.
    pub normal: Vector3<f64>,
}

impl SensorView<'_> {
    /// First surface that the line through `origin` along the unit vector `along` (spindle frame) enters
    /// between the distances `reach`; `None` also if the line begins inside a body.
    pub fn first_hit(&self, origin: Vector3<f64>, along: Vector3<f64>, reach: [f64; 2]) -> Option<SurfaceHit> {
        let [near, far] = reach;
        let length = far - near;
        let start = self.carrier_and_table.to_table_point(origin + along * near);
        let direction = self.carrier_and_table.to_table_direction(along);
        let nearest =
            |fraction: f64| self.target.nearest(start + direction * (fraction * length), self.growth, self.t_s);
        // The distance to a surface falls no faster than the line advances.
        let fraction =
            first_crossing(|fraction| nearest(fraction).distance, length, 0.0).filter(|fraction| *fraction > 0.0)?;
        let normal = self.carrier_and_table.to_spindle_direction(nearest(fraction).normal);
        Some(SurfaceHit { distance: near + fraction * length, normal })
    }
}
