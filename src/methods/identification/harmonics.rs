//! Periodic functions whose coefficients are linear in the unknowns: values, curves, ranges, amplitudes.

use std::f64::consts::TAU;

use faer::Mat;
use machine::record::estimate::{EstimatedFunction, FunctionFigureKind, Unit};

use super::estimate::Identification;
use super::output_range::RangeOutput;
use super::outputs::{OutputCurve, OutputParameter, dot_product};

/// Cosine and sine part of one harmonic.
#[derive(Debug, Clone)]
pub struct Harmonic {
    /// Order of the harmonic: periods per revolution; below 1 for a sub-harmonic.
    pub order: f64,
    /// Derivatives of the cosine and of the sine part by each unknown, internal units.
    pub cosine_and_sine_slopes: [Vec<f64>; 2],
}

/// A sum of harmonics. Orders that are not identifiable are left out.
#[derive(Debug, Clone)]
pub struct HarmonicFunction {
    pub symbol: String,
    /// Unit in which the estimate reports the function.
    pub unit: Unit,
    pub harmonics: Vec<Harmonic>,
}

/// Number of angles at which the largest and the smallest value of a function are searched.
const RANGE_ANGLE_COUNT: usize = 360;

impl HarmonicFunction {
    /// The function with only the orders that `is_kept` accepts.
    pub fn retain_orders(mut self, is_kept: impl Fn(f64) -> bool) -> Self {
        self.harmonics.retain(|harmonic| is_kept(harmonic.order));
        self
    }

    /// Derivative of the value at the angle, rad, by each unknown; empty if there are no harmonics.
    fn slope_at(&self, angle: f64) -> Vec<f64> {
        let unknowns = self.harmonics.first().map_or(0, |harmonic| harmonic.cosine_and_sine_slopes[0].len());
        let mut sum = vec![0.0; unknowns];
        for Harmonic { order, cosine_and_sine_slopes: parts } in &self.harmonics {
            let (sin, cos) = (order * angle).sin_cos();
            for (part, factor) in parts.iter().zip([cos, sin]) {
                sum.iter_mut().zip(part).for_each(|(sum, slope)| *sum += factor * slope);
            }
        }
        sum
    }

    /// Values at `count` equally spaced angles, from 0.
    pub fn values_at_equal_angles(&self, count: usize, x: &[f64]) -> Vec<f64> {
        let slopes = (0..count).map(|i| self.slope_at(i as f64 * TAU / count as f64));
        slopes.map(|slope| dot_product(&slope, x)).collect()
    }

    /// The curve over one revolution of the axis `argument`, with the end point equal to the start point.
    pub fn curve(&self, argument: &'static str, points: usize, x: &[f64]) -> OutputCurve {
        let at: Vec<f64> = (0..=points).map(|i| i as f64 * 360.0 / points as f64).collect();
        let slopes: Vec<Vec<f64>> = at.iter().map(|deg| self.slope_at(deg.to_radians())).collect();
        OutputCurve {
            symbol: self.symbol.clone(),
            argument,
            argument_unit: "deg",
            y: slopes.iter().map(|slope| dot_product(slope, x)).collect(),
            x: at,
            unit: self.unit,
            figure: FunctionFigureKind::Polar,
            slopes,
        }
    }

    /// Cosine and sine part of each harmonic, with symbols such as `EXC_c2` and `EXC_s2`.
    pub fn coefficient_outputs(&self, x: &[f64]) -> Vec<OutputParameter> {
        let mut outputs = Vec::new();
        for Harmonic { order, cosine_and_sine_slopes: parts } in &self.harmonics {
            for (part, slope) in ["c", "s"].into_iter().zip(parts) {
                let symbol = format!("{}_{part}{order}", self.symbol);
                outputs.push(OutputParameter::from_coefficients(&symbol, self.unit, slope.clone(), x));
            }
        }
        outputs
    }

    /// Largest minus smallest value over one revolution. `None`: there are no harmonics.
    pub fn range_output(&self, symbol: String) -> Option<RangeOutput> {
        let angle = |i: usize| i as f64 / RANGE_ANGLE_COUNT as f64 * TAU;
        let slopes = (0..RANGE_ANGLE_COUNT).map(|i| self.slope_at(angle(i))).collect();
        (!self.harmonics.is_empty()).then_some(RangeOutput { symbol, unit: self.unit, slopes })
    }
}

/// Values over the harmonic order in `unit`, without a stated uncertainty.
pub fn function_over_harmonic_orders(
    symbol: &str,
    unit: Unit,
    points: impl Iterator<Item = (f64, f64)>,
) -> EstimatedFunction {
    let (x, y): (Vec<f64>, Vec<f64>) = points.unzip();
    EstimatedFunction {
        symbol: symbol.to_owned(),
        argument: "order".to_owned(),
        argument_unit: String::new(),
        u: vec![0.0; x.len()],
        x,
        unit,
        y,
        figure: FunctionFigureKind::Spectrum,
        at_mm: None,
    }
}

/// Function in um of values in mm, numbered from 1 in the order given, without a stated uncertainty. If the values are
/// in order of time, a step between them indicates a shift during the measurement.
pub fn function_of_numbered_values(symbol: &str, argument: &str, mm: impl Iterator<Item = f64>) -> EstimatedFunction {
    let (x, y): (Vec<f64>, Vec<f64>) = (1..).map(f64::from).zip(mm.map(|mm| mm * 1e3)).unzip();
    EstimatedFunction {
        argument: argument.to_owned(),
        figure: FunctionFigureKind::Points,
        ..function_over_harmonic_orders(symbol, Unit::Um, x.into_iter().zip(y))
    }
}

impl Identification {
    /// Amplitudes at the solution `x` over the order. The u of an amplitude is the largest u that the
    /// harmonic has at any phase, because the phase of an amplitude near zero is unknown and its derivative
    /// does not exist there. An amplitude below 2u does not differ significantly from zero.
    pub fn spectrum(&self, function: &HarmonicFunction, x: &[f64]) -> EstimatedFunction {
        let mut points: Vec<[f64; 3]> =
            function.harmonics.iter().map(|harmonic| self.order_amplitude_and_u(harmonic, x)).collect();
        points.sort_by(|one, other| one[0].total_cmp(&other[0]));
        let reported = |value: f64| function.unit.to_reported_value(value);
        let amplitudes = points.iter().map(|[order, amplitude, _]| (*order, reported(*amplitude)));
        EstimatedFunction {
            u: points.iter().map(|[.., u]| reported(*u)).collect(),
            ..function_over_harmonic_orders(&format!("{}_spectrum", function.symbol), function.unit, amplitudes)
        }
    }

    /// Order, amplitude and u, internal units.
    fn order_amplitude_and_u(&self, harmonic: &Harmonic, x: &[f64]) -> [f64; 3] {
        let [cos, sin] = harmonic.cosine_and_sine_slopes.each_ref().map(|slope| dot_product(slope, x));
        let slopes = Mat::from_fn(2, x.len(), |part, j| harmonic.cosine_and_sine_slopes[part][j]);
        let covariance = self.propagation.output_covariance(&slopes);
        [harmonic.order, cos.hypot(sin), largest_eigenvalue_2x2(&covariance).sqrt()]
    }
}

/// Largest eigenvalue of a symmetric 2 × 2 matrix.
fn largest_eigenvalue_2x2(covariance: &Mat<f64>) -> f64 {
    let mean = (covariance[(0, 0)] + covariance[(1, 1)]) / 2.0;
    let half_difference = (covariance[(0, 0)] - covariance[(1, 1)]) / 2.0;
    mean + half_difference.hypot(covariance[(0, 1)])
}
