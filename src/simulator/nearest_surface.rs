//! Nearest point of a surface.

use nalgebra::Vector3;

/// Nearest point of the surface: signed distance (negative inside) and outward normal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct NearestSurface {
    pub distance: f64,
    pub normal: Vector3<f64>,
}

impl NearestSurface {
    /// No surface within the distance.
    pub fn beyond(distance: f64) -> Self {
        Self { distance, normal: Vector3::z() }
    }

    /// Nearest point of a prism: signed distances from the side and from the nearer end, with their outward normals.
    pub fn of_prism(side: f64, side_normal: Vector3<f64>, end: f64, end_normal: Vector3<f64>) -> Self {
        if side > 0.0 && end > 0.0 {
            let distance = side.hypot(end);
            Self { distance, normal: (side_normal * side + end_normal * end) / distance }
        } else if side > end {
            Self { distance: side, normal: side_normal }
        } else {
            Self { distance: end, normal: end_normal }
        }
    }

    /// The nearer of two surfaces; `self` if both are equally near.
    pub fn or_nearer(self, other: Self) -> Self {
        if other.distance < self.distance { other } else { self }
    }
}
