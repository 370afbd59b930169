//! Test of the radial error of X and Y against the declared sources. No residual contains this error, because each
//! of its values is an unknown.

use std::f64::consts::TAU;

use faer::{Mat, Side};

use super::identify::SolvedRun;
use super::model::UnknownsLayout;
use crate::identification::dot_product;
use estimation::coverage::chi_square_bounds;

/// Probability that χ² is within its two-sided bounds if all sources are as declared. Only the upper bound is used.
const CHI2_BOUNDS_PROBABILITY: f64 = 0.998;
/// Ratio to the largest eigenvalue of the scaled covariance below which an eigenvalue is a rounding error.
const MIN_KEPT_EIGENVALUE_RATIO: f64 = 1e-9;
/// Order of the harmonic that is scale difference and squareness of X and Y.
const SCALE_AND_SQUARENESS_ORDER: usize = 2;

/// Combined harmonics of E_radial.
#[derive(Debug, Clone, PartialEq)]
pub struct RadialHarmonics {
    /// Square root of the sum of squares of the cosine and sine parts, mm.
    pub amplitude_mm: f64,
    /// χ² of the cosine and sine parts against zero, with their covariance.
    pub amplitude_chi2: f64,
    /// Expectation of χ² if all sources are as declared.
    pub expected_chi2: f64,
    /// Whether χ² exceeds what the declared sources explain.
    pub is_excessive: bool,
}

/// The second harmonic, which is reported as parameters, and the higher harmonics, which are in no parameter. `None`:
/// the grid of angles does not determine the harmonics.
#[derive(Debug, Clone, PartialEq)]
pub struct RadialErrorCheck {
    pub second_harmonic: Option<RadialHarmonics>,
    pub higher_harmonics: Option<RadialHarmonics>,
}

impl RadialErrorCheck {
    pub fn new(parts: &SolvedRun<'_>) -> Self {
        let highest = parts.fit.layout.design.angle_count / 2;
        let of_orders = |orders: std::ops::RangeInclusive<usize>| {
            let slopes: Vec<Vec<f64>> =
                orders.flat_map(|order| radial_error_harmonic_slopes(&parts.fit.layout, order)).collect();
            combine_harmonics(parts, &slopes)
        };
        Self {
            second_harmonic: of_orders(SCALE_AND_SQUARENESS_ORDER..=SCALE_AND_SQUARENESS_ORDER),
            higher_harmonics: of_orders(SCALE_AND_SQUARENESS_ORDER + 1..=highest),
        }
    }

    pub fn warnings(&self, axis: machine::Axis) -> Vec<String> {
        let mut lines = Vec::new();
        let line = |what: &str, of: &RadialHarmonics, meaning: String| {
            let (um, chi2, expected) = (of.amplitude_mm * 1e3, of.amplitude_chi2, of.expected_chi2);
            format!(
                "{what} {um:.2} µm, more than the declared sources explain (χ² {chi2:.1} where \
                     {expected:.0} is expected): {meaning}"
            )
        };
        if let Some(second) = self.second_harmonic.as_ref().filter(|second| second.is_excessive) {
            lines.push(line(
                "the second harmonic of E_radial_XY is",
                second,
                "EYY1-EXX1 and EC0Y attribute it to the axes. Two lobes of the probe, or backlash of X or \
                Y, have the same effect: declare the largest possible lobing_um and backlash_um"
                    .to_owned(),
            ));
        }
        if let Some(higher) = self.higher_harmonics.as_ref().filter(|higher| higher.is_excessive) {
            lines.push(line(
                "the harmonics of E_radial_XY above the second are",
                higher,
                format!(
                    "lobing of the probe, backlash or error motions of X and Y exceed the declared \
                    lobing_um, backlash_um and error_motion_um. U of EX0{axis} and EY0{axis} is a lower \
                    bound"
                ),
            ));
        }
        lines
    }
}

/// Coefficients over the unknowns of the cosine and the sine part of a harmonic of E_radial, averaged over the
/// heights.
fn radial_error_harmonic_slopes(layout: &UnknownsLayout, order: usize) -> Vec<Vec<f64>> {
    let n = layout.design.angle_count;
    let part = |quarter_turns: f64| {
        let mut slope = vec![0.0; layout.unknown_count()];
        for height in 0..layout.height_count {
            for i in 0..n {
                let phase = order as f64 * layout.design.grid_angle_rad(i) - quarter_turns * TAU;
                let weight = 2.0 / (n * layout.height_count) as f64;
                slope[layout.linear_axes_radial_error_index(height, i)] += weight * phase.cos();
            }
        }
        slope
    };
    // On an even grid the highest order has no sine part.
    let parts: &[f64] = if 2 * order == n { &[0.0] } else { &[0.0, 0.25] };
    parts.iter().map(|turns| part(*turns)).collect()
}

/// `None`: there is no harmonic, or the covariance of the harmonics is zero.
fn combine_harmonics(parts: &SolvedRun<'_>, slopes: &[Vec<f64>]) -> Option<RadialHarmonics> {
    if slopes.is_empty() {
        return None;
    }
    let unknowns = parts.fit.layout.unknown_count();
    let values: Vec<f64> = slopes.iter().map(|slope| dot_product(slope, &parts.fit.x)).collect();
    let slopes = Mat::from_fn(slopes.len(), unknowns, |i, j| slopes[i][j]);
    let covariance = parts.identification.propagation.output_covariance(&slopes);
    let (chi2, rank) = chi2_and_rank(&values, &covariance)?;
    let (_, upper) = chi_square_bounds(rank as f64, CHI2_BOUNDS_PROBABILITY)?;
    let amplitude_mm = values.iter().map(|value| value * value).sum::<f64>().sqrt();
    Some(RadialHarmonics { amplitude_mm, amplitude_chi2: chi2, expected_chi2: rank as f64, is_excessive: chi2 > upper })
}

/// Weighted square vᵀ·C⁺·v of the values v, and the rank of their covariance C.
fn chi2_and_rank(values: &[f64], covariance: &Mat<f64>) -> Option<(f64, usize)> {
    let eigen = covariance.self_adjoint_eigen(Side::Lower).ok()?;
    let variances = eigen.S().column_vector();
    let largest = variances.iter().copied().fold(0.0, f64::max);
    let kept = (0..values.len()).filter(|j| variances[*j] > MIN_KEPT_EIGENVALUE_RATIO * largest);
    let square = |j: usize| {
        let along: f64 = (0..values.len()).map(|i| eigen.U()[(i, j)] * values[i]).sum();
        along * along / variances[j]
    };
    let squares: Vec<f64> = kept.map(square).collect();
    (!squares.is_empty()).then(|| (squares.iter().sum(), squares.len()))
}
