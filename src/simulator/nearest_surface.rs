//! Nearest point of a surface.

use nalgebra::Vector3;

/// Nearest point of the surface: signed distance (negative inside) and outward normal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct NearestSurface {
    pub distance: f64,
    pub normal: Vector3<f64>,
}
