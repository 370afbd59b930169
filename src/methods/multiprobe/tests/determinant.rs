//! Determinant of three sensors (paper 3, Eq. (11)).

use faer::c64;

/// Determinants below this value count as zero.
const ZERO_DETERMINANT_THRESHOLD: f64 = 1e-20;
/// Determinant below which a harmonic is weak: its noise is larger than that of a single sensor.
const WEAK_DETERMINANT_THRESHOLD: f64 = 1.0;

/// φ² + δ² of paper 3, Eq. (10), for the harmonic `order`. It is infinite if the second and third sensor coincide
/// or are opposed.
pub fn separation_determinant(angles_deg: [f64; 3], order: usize) -> f64 {
    let [alpha, beta] = [1, 2].map(|i| (angles_deg[i] - angles_deg[0]).to_radians());
    let a = beta.sin() / (alpha - beta).sin();
    let b = alpha.sin() / (beta - alpha).sin();
    let turn = |angle: f64| c64::cis(order as f64 * angle);
    (c64::new(1.0, 0.0) + turn(alpha) * a + turn(beta) * b).norm_sqr()
}

/// Harmonics of 1..=`max_order` that the three sensors alone do not determine.
pub fn suppressed_orders(angles_deg: [f64; 3], max_order: usize) -> Vec<usize> {
    let is_zero = |order: &usize| separation_determinant(angles_deg, *order) < ZERO_DETERMINANT_THRESHOLD;
    (1..=max_order).filter(is_zero).collect()
}

/// Harmonics of 1..=`max_order` with a small determinant other than zero.
pub fn weak_orders(angles_deg: [f64; 3], max_order: usize) -> Vec<usize> {
    let is_weak = |order: &usize| {
        (ZERO_DETERMINANT_THRESHOLD..WEAK_DETERMINANT_THRESHOLD).contains(&separation_determinant(angles_deg, *order))
    };
    (1..=max_order).filter(is_weak).collect()
}
