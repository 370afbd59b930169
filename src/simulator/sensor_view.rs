//! The nearest true surface along a straight line of sight.

use nalgebra::Vector3;

use super::nearest::Nearest;
use super::ramp::first_crossing;
use super::stand::MachinePose;
use super::surface::Surface;

/// The scene at one moment, as seen from the part that carries a sensor.
#[derive(Debug, Clone, Copy)]
pub(super) struct SensorView<'a> {
    /// Pose of the carrier, in place of the spindle.
    pub stand: MachinePose,
    pub target: Target<'a>,
    /// Growth of the radius of a round part, mm.
    pub growth: f64,
    pub t_s: f64,
}

/// Object that a sensor measures.
#[derive(Debug, Clone, Copy)]
pub(super) enum Target<'a> {
    /// The artefact.
    Surface(&'a Surface),
    /// The sphere in the spindle; centre in the table frame, mm.
    Sphere { centre: Vector3<f64>, radius: f64 },
}

impl Target<'_> {
    /// Nearest surface to `point` in the table frame.
    fn nearest(&self, point: Vector3<f64>, growth: f64, t_s: f64) -> Nearest {
        match self {
            Self::Surface(surface) => surface.nearest(point, growth, t_s),
            Self::Sphere { centre, radius } => {
                let from_centre = point - centre;
                let normal = from_centre.try_normalize(0.0).unwrap_or(Vector3::z());
                Nearest { distance: from_centre.norm() - radius, normal }
            }
        }
    }
}

/// End point of a line of sight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Hit {
    /// Distance from the line's origin, mm.
    pub distance: f64,
    /// Outward unit normal of the surface there, spindle frame.
    pub normal: Vector3<f64>,
}

impl SensorView<'_> {
    /// First surface that the line through `origin` along the unit vector `along` (spindle frame) enters
    /// between the distances `reach`; `None` also if the line begins inside a body.
    pub fn first(&self, origin: Vector3<f64>, along: Vector3<f64>, reach: [f64; 2]) -> Option<Hit> {
        let [near, far] = reach;
        let length = far - near;
        let start = self.stand.on_table(origin + along * near);
        let way = self.stand.turned_to_table(along);
        let nearest =
            |at: f64| self.target.nearest(start + way * (at * length), self.growth, self.t_s);
        // The distance to a surface falls no faster than the line advances.
        let at = first_crossing(|at| nearest(at).distance, length, 0.0).filter(|at| *at > 0.0)?;
        let normal = self.stand.turned_to_spindle(nearest(at).normal);
        Some(Hit { distance: near + at * length, normal })
    }
}
