//! Smooth random functions: what is known of a deviation that is declared by its size and by the
//! distance over which it changes.

use faer::{Mat, Side};

/// Directions smaller than this part of the largest are left out.
const NEGLIGIBLE: f64 = 1e-9;

/// A function f of standard deviation `sigma` with covariance σ²·exp(−Δ²/2ℓ²), ℓ = `length`, of which
/// f(x) − f(0) is seen at `places`: columns B, one entry a place, such that B·(independent draws of unit
/// variance) is f(x) − f(0). No places, no columns.
pub fn smooth_function(places: &[f64], sigma: f64, length: f64) -> Vec<Vec<f64>> {
    let bell = bell(length);
    columns(places, |u, v| sigma * sigma * (bell(u - v) - bell(u) - bell(v) + 1.0))
}

/// The same of f(x) itself.
pub fn stationary_function(places: &[f64], sigma: f64, length: f64) -> Vec<Vec<f64>> {
    let bell = bell(length);
    columns(places, |u, v| sigma * sigma * bell(u - v))
}

fn bell(length: f64) -> impl Fn(f64) -> f64 {
    move |d| (-0.5 * (d / length).powi(2)).exp()
}

/// Columns B with B·Bᵀ = the covariance of the values at `places`.
fn columns(places: &[f64], covariance: impl Fn(f64, f64) -> f64) -> Vec<Vec<f64>> {
    let mut nodes = places.to_vec();
    nodes.sort_by(f64::total_cmp);
    nodes.dedup();
    // Nothing to decompose: the eigenvalues of a matrix without entries are not asked for.
    if nodes.is_empty() {
        return Vec::new();
    }
    let kernel = Mat::from_fn(nodes.len(), nodes.len(), |i, j| covariance(nodes[i], nodes[j]));
    let Ok(eigen) = kernel.self_adjoint_eigen(Side::Lower) else { return Vec::new() };
    let values = eigen.S().column_vector();
    let largest = values.iter().copied().fold(0.0, f64::max);
    (0..nodes.len())
        .filter(|j| values[*j] > NEGLIGIBLE * largest)
        .map(|j| {
            let scale = values[j].sqrt();
            let node = |place: &f64| nodes.partition_point(|n| n < place);
            places.iter().map(|place| eigen.U()[(node(place), j)] * scale).collect()
        })
        .collect()
}
