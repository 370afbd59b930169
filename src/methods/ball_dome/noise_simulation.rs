//! Simulated deviations on a machine without errors, from the uncertainty of the readings and the certificate.

use estimation::monte_carlo::{DrawDistribution, DrawStream};
use nalgebra::{Matrix3, Vector3};

const NOISE_TRIAL_COUNT: usize = 100;
const NOISE_SEED: u64 = 0x6e6f_6973;

/// Largest and mean deviation, mm, averaged over the trials, without the rigid fit and the fit of the stylus.
/// `weights`: whitening matrix of each point; `ball_indices`: index of the ball of each point; `certificate_u_mm`:
/// standard uncertainty of a certified coordinate.
pub fn simulate_max_and_mean_deviation_mm(
    weights: &[Matrix3<f64>],
    ball_indices: &[usize],
    certificate_u_mm: f64,
) -> [f64; 2] {
    let back: Vec<Matrix3<f64>> = weights.iter().map(|weight| weight.try_inverse().unwrap_or_default()).collect();
    let balls = ball_indices.iter().max().map_or(0, |last| last + 1);
    let mut random = DrawStream::from_key(NOISE_SEED, &[]);
    let (mut largest, mut mean) = (0.0, 0.0);
    for _ in 0..NOISE_TRIAL_COUNT {
        let units = random.unit_variance_draws(1, &vec![DrawDistribution::Normal; 3 * (ball_indices.len() + balls)]);
        let unit = |at: usize| Vector3::from_column_slice(&units[3 * at..3 * at + 3]);
        let norm =
            |i: usize| (back[i] * unit(i) + unit(ball_indices.len() + ball_indices[i]) * certificate_u_mm).norm();
        let norms: Vec<f64> = (0..ball_indices.len()).map(norm).collect();
        largest += norms.iter().copied().fold(0.0, f64::max) / NOISE_TRIAL_COUNT as f64;
        mean += norms.iter().sum::<f64>() / (norms.len() * NOISE_TRIAL_COUNT) as f64;
    }
    [largest, mean]
}
