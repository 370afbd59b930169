//! Common fit of circle and sphere: points at one distance from a centre, in D dimensions. The fit minimises the sum
//! of the squared radial deviations (geometric fit, also called orthogonal distance fit).

mod gauss_newton;
mod many_points;
mod point_sums;

use faer::Mat;

/// Least-squares circle or sphere, in the unit of the points.
pub(super) struct RadialFit<const D: usize> {
    pub centre: [f64; D],
    pub radius: f64,
    /// Distance from the centre less radius, one per point.
    pub residuals: Vec<f64>,
    /// Covariance of the centre coordinates, then the radius, for a standard uncertainty of 1 of each radial
    /// deviation.
    pub covariance: Mat<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RadialError {
    /// Contains the number of points.
    TooFewPoints(usize),
    /// The points are on one line (D = 2) or in one plane (D = 3), or coincide.
    CollinearOrCoplanar,
    NotFinite,
    NotConverged,
}

/// Tolerance of a step: the effect of the rounding of the distances, in standard uncertainties for a radial
/// standard deviation of one radius.
const STEP_TOLERANCE: f64 = 4e-15;

/// Fits centre and radius of a circle (D = 2) or sphere (D = 3).
pub(super) fn fit_circle_or_sphere<const D: usize>(points: &[[f64; D]]) -> Result<RadialFit<D>, RadialError> {
    many_points::fit_many_points(points).map_or_else(|| gauss_newton::fit_gauss_newton(points), Ok)
}
