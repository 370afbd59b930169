//! A measurement that is compared with all others: a touch, a ball centre or a mean, depending on the method.

use std::ops::Range;

use nalgebra::Matrix3;

/// A unit of the observations that may be an outlier.
#[derive(Debug, Clone)]
pub struct MeasurementToCheck {
    /// Label in the plan.
    pub label: String,
    pub description: String,
    /// Indices of the measurement's rows in the weighted residuals.
    pub residual_rows: Range<usize>,
    /// Residual of the measurement, mm: outward along a touch; for a point, the length of its residual
    /// vector.
    pub residual_mm: f64,
    /// Standard uncertainty from the sources in the weights, mm; for a point, of one coordinate.
    pub u_mm: f64,
    /// Mean time of the readings of the measurement, on the clock of the readings, s.
    pub mean_time_s: f64,
}

/// Standard uncertainty of a coordinate, mm, that corresponds to the mean weight of the three coordinates. `weight`
/// converts mm to weighted rows.
pub fn mean_coordinate_u_mm(weight: &Matrix3<f64>) -> f64 {
    3f64.sqrt() / weight.norm()
}
