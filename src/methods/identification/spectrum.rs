//! Amplitudes of the harmonics of a function whose coefficients are linear in the unknowns.

use faer::Mat;
use machine::record::estimate::{FigureKind, Function, Unit};

use super::estimate::Identification;

/// Cosine and sine part of one harmonic.
#[derive(Debug, Clone)]
pub struct Harmonic {
    /// Periods in one revolution; below 1 for a sub-harmonic.
    pub order: f64,
    /// Derivatives of the cosine and of the sine part by each unknown, internal units.
    pub parts: [Vec<f64>; 2],
}

/// Amplitude over order. An order that is not identifiable is left out.
#[derive(Debug, Clone)]
pub struct Spectrum {
    pub symbol: String,
    /// In which the estimate reports it.
    pub unit: Unit,
    pub harmonics: Vec<Harmonic>,
}

impl Identification {
    /// The spectrum at the solution `x`. u of an amplitude is the largest u that the harmonic has at any phase: the
    /// phase of an amplitude near zero is not known, and a derivative along it does not exist. An
    /// amplitude below 2u does not differ from zero.
    pub fn spectrum(&self, spectrum: &Spectrum, x: &[f64]) -> Function {
        let mut points: Vec<[f64; 3]> =
            spectrum.harmonics.iter().map(|harmonic| self.amplitude(harmonic, x)).collect();
        points.sort_by(|one, other| one[0].total_cmp(&other[0]));
        let reported = |value: f64| spectrum.unit.from_internal(value);
        Function {
            symbol: spectrum.symbol.clone(),
            argument: "order".to_owned(),
            argument_unit: String::new(),
            x: points.iter().map(|[order, ..]| *order).collect(),
            unit: spectrum.unit,
            y: points.iter().map(|[_, amplitude, _]| reported(*amplitude)).collect(),
            u: points.iter().map(|[.., u]| reported(*u)).collect(),
            figure: FigureKind::Spectrum,
        }
    }

    /// Order, amplitude and u, internal units.
    fn amplitude(&self, harmonic: &Harmonic, x: &[f64]) -> [f64; 3] {
        let [cos, sin] = harmonic
            .parts
            .each_ref()
            .map(|slope| -> f64 { slope.iter().zip(x).map(|(slope, x)| slope * x).sum() });
        let slopes = Mat::from_fn(2, x.len(), |part, j| harmonic.parts[part][j]);
        let covariance = self.propagation.covariance(&slopes);
        [harmonic.order, cos.hypot(sin), largest_variance(&covariance).sqrt()]
    }
}

/// Largest eigenvalue of a symmetric 2 × 2 matrix.
fn largest_variance(covariance: &Mat<f64>) -> f64 {
    let mean = (covariance[(0, 0)] + covariance[(1, 1)]) / 2.0;
    let half_difference = (covariance[(0, 0)] - covariance[(1, 1)]) / 2.0;
    mean + half_difference.hypot(covariance[(0, 1)])
}
