//! Smooth random functions (Gaussian process): model of a deviation that is declared by its size and by the
//! distance over which it changes.

use faer::{Mat, Side};

/// Eigenvectors of the covariance whose eigenvalue is not above this ratio to the largest eigenvalue are omitted.
const NEGLIGIBLE_EIGENVALUE_RATIO: f64 = 1e-9;

/// Columns B such that B·(independent draws of unit variance) is f(x) − f(0) at `positions`, one entry per position. f
/// is a random function of standard deviation `sigma` with covariance σ²·exp(−Δ²/2ℓ²), ℓ = `correlation_length`.
/// Without positions there are no columns.
pub fn smooth_change_from_zero_columns(positions: &[f64], sigma: f64, correlation_length: f64) -> Vec<Vec<f64>> {
    let bell = squared_exponential(correlation_length);
    covariance_factor_columns(positions, |u, v| sigma * sigma * (bell(u - v) - bell(u) - bell(v) + 1.0))
}

/// Like [`smooth_change_from_zero_columns`], but the columns give f(x) and not f(x) − f(0).
pub fn stationary_function_columns(positions: &[f64], sigma: f64, correlation_length: f64) -> Vec<Vec<f64>> {
    let bell = squared_exponential(correlation_length);
    covariance_factor_columns(positions, |u, v| sigma * sigma * bell(u - v))
}

/// exp(−d²/2ℓ²) of a distance d: 1 at d = 0, without the variance.
fn squared_exponential(correlation_length: f64) -> impl Fn(f64) -> f64 {
    move |d| (-0.5 * (d / correlation_length).powi(2)).exp()
}

/// Columns B such that B·Bᵀ is the covariance of the values at `positions`; `covariance` gives it for two positions.
/// Empty if the eigendecomposition fails.
fn covariance_factor_columns(positions: &[f64], covariance: impl Fn(f64, f64) -> f64) -> Vec<Vec<f64>> {
    let mut nodes = positions.to_vec();
    nodes.sort_by(f64::total_cmp);
    nodes.dedup();
    // The eigendecomposition is not defined for a matrix without entries.
    if nodes.is_empty() {
        return Vec::new();
    }
    let kernel = Mat::from_fn(nodes.len(), nodes.len(), |i, j| covariance(nodes[i], nodes[j]));
    let Ok(eigen) = kernel.self_adjoint_eigen(Side::Lower) else { return Vec::new() };
    let values = eigen.S().column_vector();
    let largest = values.iter().copied().fold(0.0, f64::max);
    (0..nodes.len())
        .filter(|j| values[*j] > NEGLIGIBLE_EIGENVALUE_RATIO * largest)
        .map(|j| {
            let scale = values[j].sqrt();
            let node = |position: &f64| nodes.partition_point(|n| n < position);
            positions.iter().map(|position| eigen.U()[(node(position), j)] * scale).collect()
        })
        .collect()
}
