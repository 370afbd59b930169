//! Trigonometric interpolation of periodic samples at equal steps, by a plain Fourier sum: a revolution has at most
//! a few hundred samples.

use std::f64::consts::TAU;

use faer::c64 as Complex64;

/// Trigonometric polynomial of least degree through samples at θ_i = 2πi/N, i = 0..N.
///
/// For even N the highest term is a·cos(Nθ/2). Its sine is zero at all samples and is set to 0 (the interpolant of
/// least variation).
#[derive(Debug, Clone)]
pub struct TrigonometricInterpolant {
    /// Coefficients of exp(ikθ), k = 0..=N/2, with ±k combined: the function is Re Σ c_k exp(ikθ).
    coefficients: Vec<Complex64>,
}

impl TrigonometricInterpolant {
    /// Interpolates `samples` of one full turn. Without samples the function is zero.
    pub fn new(samples: &[f64]) -> Self {
        let count = samples.len();
        if count == 0 {
            return Self { coefficients: Vec::new() };
        }
        let phase = |steps: usize| TAU * (steps % count) as f64 / count as f64;
        let coefficient = |order: usize| {
            // The terms ±k are combined into one. The mean and the Nyquist term have no counterpart.
            let folded = if order == 0 || 2 * order == count { 1.0 } else { 2.0 };
            let terms = samples.iter().enumerate();
            let sum: Complex64 = terms.map(|(i, v)| Complex64::cis(-phase(order * i)) * *v).sum();
            sum * (folded / count as f64)
        };
        Self { coefficients: (0..=count / 2).map(coefficient).collect() }
    }

    /// Derivative per rad at `angle` (rad).
    pub fn derivative(&self, angle: f64) -> f64 {
        let term = |order: usize, c: &Complex64| c * Complex64::cis(order as f64 * angle);
        self.coefficients.iter().enumerate().map(|(order, c)| -(order as f64) * term(order, c).im).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn interpolate_function(count: usize, f: impl Fn(f64) -> f64) -> TrigonometricInterpolant {
        let values: Vec<f64> = (0..count).map(|i| f(i as f64 * TAU / count as f64)).collect();
        TrigonometricInterpolant::new(&values)
    }

    #[test]
    fn derivative_equals_that_of_a_function_of_low_harmonics() {
        let f = |t: f64| 0.7 + 2.0 * t.cos() - 0.3 * t.sin() + 0.25 * (3.0 * t + 0.4).cos();
        let slope = |t: f64| -2.0 * t.sin() - 0.3 * t.cos() - 0.75 * (3.0 * t + 0.4).sin();
        for count in [7, 8, 9, 36] {
            let found = interpolate_function(count, f);
            for i in 0..50 {
                let t = 0.37 * f64::from(i) - 4.0;
                assert!((found.derivative(t) - slope(t)).abs() < 1e-12, "{count} {t}");
            }
        }
    }

    #[test]
    fn highest_harmonic_of_even_count_is_a_cosine() {
        let found = interpolate_function(8, |t| (4.0 * t).cos());
        for t in [0.0, 0.1, 0.5, 2.0] {
            assert!((found.derivative(t) + 4.0 * (4.0 * t).sin()).abs() < 1e-13);
        }
        assert_eq!(TrigonometricInterpolant::new(&[]).derivative(1.0), 0.0);
    }
}
