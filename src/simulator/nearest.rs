//! The nearest point of a surface.

use glam::DVec3;

/// Nearest point of the surface: signed distance (negative inside) and outward normal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Nearest {
    pub distance: f64,
    pub normal: DVec3,
}
