//! Nearest point of a surface.

use nalgebra::Vector3;

/// Nearest point of the surface: signed distance, mm (negative inside), and outward unit normal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct NearestSurface {
    pub signed_distance: f64,
    pub outward_normal: Vector3<f64>,
}

impl NearestSurface {
    /// Result for a point without a surface nearer than `distance`.
    pub fn no_surface_within(distance: f64) -> Self {
        Self { signed_distance: distance, outward_normal: Vector3::z() }
    }

    /// Nearest point of a prism: signed distances from the side and from the nearer end, with their outward normals.
    pub fn from_prism_side_and_end(
        side_distance: f64,
        side_normal: Vector3<f64>,
        end_distance: f64,
        end_normal: Vector3<f64>,
    ) -> Self {
        if side_distance > 0.0 && end_distance > 0.0 {
            let distance = side_distance.hypot(end_distance);
            Self {
                signed_distance: distance,
                outward_normal: (side_normal * side_distance + end_normal * end_distance) / distance,
            }
        } else if side_distance > end_distance {
            Self { signed_distance: side_distance, outward_normal: side_normal }
        } else {
            Self { signed_distance: end_distance, outward_normal: end_normal }
        }
    }

    /// The nearer of two surfaces; `self` if both are equally near.
    pub fn or_nearer(self, other: Self) -> Self {
        if other.signed_distance < self.signed_distance { other } else { self }
    }
}
