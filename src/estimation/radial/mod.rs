//! What circle and sphere have in common: points at one distance from a centre, in D dimensions.
//! The sum of the squared radial deviations is least (geometric or orthogonal distance fit).

mod gauss_newton;
mod lanes;
mod many;

use faer::Mat;

/// In the unit of the points.
pub(super) struct Radial<const D: usize> {
    pub centre: [f64; D],
    pub radius: f64,
    /// Distance from the centre less radius, one per point.
    pub residuals: Vec<f64>,
    /// Of centre and radius, for a standard uncertainty of 1 of each radial deviation.
    pub covariance: Mat<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RadialError {
    TooFew(usize),
    /// The points lie in one line (D = 2) or plane (D = 3), or coincide.
    Flat,
    NotFinite,
    NotConverged,
}

/// In standard uncertainties that a radial deviation of one radius would cause: what the rounding of
/// the distances can cause.
const TOLERANCE: f64 = 4e-15;

/// Fits centre and radius.
pub(super) fn fit<const D: usize>(points: &[[f64; D]]) -> Result<Radial<D>, RadialError> {
    many::fit(points).map_or_else(|| gauss_newton::careful(points), Ok)
}
