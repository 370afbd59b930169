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
    sample_count: usize,
    /// Coefficients of exp(ikθ), k = 0..=N/2, with ±k combined: the function is Re Σ c_k exp(ikθ).
    coefficients: Vec<Complex64>,
}

impl TrigonometricInterpolant {
    /// Interpolates `samples` of one full turn. Without samples the function is zero.
    pub fn new(samples: &[f64]) -> Self {
        let count = samples.len();
        if count == 0 {
            return Self { sample_count: 0, coefficients: Vec::new() };
        }
        let phase = |steps: usize| TAU * (steps % count) as f64 / count as f64;
        let coefficient = |order: usize| {
            // The terms ±k are combined into one. The mean and the Nyquist term have no counterpart.
            let folded = if order == 0 || 2 * order == count { 1.0 } else { 2.0 };
            let terms = samples.iter().enumerate();
            let sum: Complex64 = terms.map(|(i, v)| Complex64::cis(-phase(order * i)) * *v).sum();
            sum * (folded / count as f64)
        };
        let coefficients = (0..=count / 2).map(coefficient).collect();
        Self { sample_count: count, coefficients }
    }

    /// Value at `angle` (rad).
    pub fn value(&self, angle: f64) -> f64 {
        self.harmonic_terms(angle).map(|(_, term)| term.re).sum()
    }

    /// Derivative per rad at `angle` (rad).
    pub fn derivative(&self, angle: f64) -> f64 {
        self.harmonic_terms(angle).map(|(order, term)| -(order as f64) * term.im).sum()
    }

    /// (a, b) of the harmonic a·cos(kθ) + b·sin(kθ); zeros beyond N/2.
    pub fn cosine_and_sine_amplitudes(&self, order: usize) -> (f64, f64) {
        self.coefficients.get(order).map_or((0.0, 0.0), |c| (c.re, -c.im))
    }

    /// Values at the N angles of the samples.
    pub fn values_at_sample_angles(&self) -> Vec<f64> {
        let step = TAU / self.sample_count.max(1) as f64;
        (0..self.sample_count).map(|i| self.value(i as f64 * step)).collect()
    }

    fn harmonic_terms(&self, angle: f64) -> impl Iterator<Item = (usize, Complex64)> + '_ {
        let turn = move |order: usize| Complex64::cis(order as f64 * angle);
        self.coefficients.iter().enumerate().map(move |(order, c)| (order, c * turn(order)))
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
    fn interpolant_equals_function_of_low_harmonics() {
        let f = |t: f64| 0.7 + 2.0 * t.cos() - 0.3 * t.sin() + 0.25 * (3.0 * t + 0.4).cos();
        let slope = |t: f64| -2.0 * t.sin() - 0.3 * t.cos() - 0.75 * (3.0 * t + 0.4).sin();
        for count in [7, 8, 9, 36] {
            let found = interpolate_function(count, f);
            for i in 0..50 {
                let t = 0.37 * f64::from(i) - 4.0;
                assert!((found.value(t) - f(t)).abs() < 1e-12, "{count} {t}");
                assert!((found.derivative(t) - slope(t)).abs() < 1e-12, "{count} {t}");
            }
        }
    }

    #[test]
    fn highest_harmonic_of_even_count_is_a_cosine() {
        let found = interpolate_function(8, |t| (4.0 * t).cos());
        for t in [0.0, 0.1, 0.5, 2.0] {
            assert!((found.value(t) - (4.0 * t).cos()).abs() < 1e-14);
            assert!((found.derivative(t) + 4.0 * (4.0 * t).sin()).abs() < 1e-13);
        }
        assert!(
            (found.cosine_and_sine_amplitudes(4).0 - 1.0).abs() < 1e-15
                && found.cosine_and_sine_amplitudes(9) == (0.0, 0.0)
        );
        let (a, b) = interpolate_function(8, |t| 2.0 * t.cos() - 0.3 * t.sin()).cosine_and_sine_amplitudes(1);
        assert!((a - 2.0).abs() < 1e-14 && (b + 0.3).abs() < 1e-14);
        assert_eq!(TrigonometricInterpolant::new(&[]).value(1.0), 0.0);
    }
}
