//! What is compared with all others: a touch, a place, a mean.

use std::ops::Range;

use nalgebra::Matrix3;

/// What may be off by itself.
#[derive(Debug, Clone)]
pub struct Measurement {
    /// As the plan labels it.
    pub label: String,
    pub in_words: String,
    /// Its rows among the weighted residuals.
    pub rows: Range<usize>,
    /// Its residual, mm: outward along a touch; of a place the length.
    pub residual_mm: f64,
    /// Standard uncertainty by the sources in the weights, mm.
    pub u_mm: f64,
}

/// Of a coordinate, mm, on average. `weight`: from mm to weighted rows.
pub fn mean_u_mm(weight: &Matrix3<f64>) -> f64 {
    3f64.sqrt() / weight.norm()
}
