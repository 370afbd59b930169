//! The nearest true surface along a straight line of sight.

use nalgebra::Vector3;

use super::machine_pose::MachinePose;
use super::nearest_surface::NearestSurface;
use super::surface::ArtefactSurface;
use super::velocity_profile::first_zero_crossing_fraction;

/// The scene at one moment, as seen from the part that carries a sensor.
#[derive(Debug, Clone, Copy)]
pub(super) struct SensorView<'a> {
    /// Poses of the table and of the part that carries the sensor.
    pub carrier_and_table: MachinePose,
    pub measured_object: MeasuredObject<'a>,
    /// Growth of the radius of a round part, mm.
    pub radius_growth_mm: f64,
    pub world_time_s: f64,
}

/// Object that a sensor measures.
#[derive(Debug, Clone, Copy)]
pub(super) enum MeasuredObject<'a> {
    /// The artefact.
    Artefact(&'a ArtefactSurface),
    /// The sphere in the spindle; centre in the table frame, mm.
    SpindleSphere { centre: Vector3<f64>, radius: f64 },
}

impl MeasuredObject<'_> {
    /// Surface nearest to `point`, both in the table frame. `growth`: growth of the radius of a round part, mm.
    fn nearest(&self, point: Vector3<f64>, growth: f64, t_s: f64) -> NearestSurface {
        match self {
            MeasuredObject::Artefact(surface) => surface.nearest(point, growth, t_s),
            MeasuredObject::SpindleSphere { centre, radius } => {
                let from_centre = point - centre;
                let normal = from_centre.try_normalize(0.0).unwrap_or(Vector3::z());
                NearestSurface { signed_distance: from_centre.norm() - radius, outward_normal: normal }
            }
        }
    }
}

/// End point of a line of sight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SurfaceHit {
    /// Distance from the line's origin, mm.
    pub distance_from_origin_mm: f64,
    /// Outward unit normal of the surface at this point, frame of the sensor's carrier.
    pub outward_normal: Vector3<f64>,
}

impl SensorView<'_> {
    /// First surface that the line through `origin` along the unit vector `along` (frame of the carrier) enters within
    /// `distance_range`. `None`: there is none, or the line begins inside a body.
    pub fn first_hit(&self, origin: Vector3<f64>, along: Vector3<f64>, distance_range: [f64; 2]) -> Option<SurfaceHit> {
        let [near, far] = distance_range;
        let length = far - near;
        let start = self.carrier_and_table.carrier_to_table_point(origin + along * near);
        let direction = self.carrier_and_table.carrier_to_table_direction(along);
        let nearest = |fraction: f64| {
            let point = start + direction * (fraction * length);
            self.measured_object.nearest(point, self.radius_growth_mm, self.world_time_s)
        };
        // The distance to a surface falls no faster than the line advances.
        let fraction = first_zero_crossing_fraction(|fraction| nearest(fraction).signed_distance, length, 0.0)
            .filter(|fraction| *fraction > 0.0)?;
        let normal = self.carrier_and_table.table_to_carrier_direction(nearest(fraction).outward_normal);
        Some(SurfaceHit { distance_from_origin_mm: near + fraction * length, outward_normal: normal })
    }
}
