//! The latency between sensor and axis positions, and the lost motion of the axes at reversals, from forward and
//! backward passes at two feeds. Latency shifts a pass in proportion to the velocity, lost motion by the sign of the
//! velocity only. At one feed latency and lost motion are not separable.
//!
//! Only passes through the same cell are compared. The contributions of the sphere, the sensor's linearity and the
//! tilt of its beam are the same there in both directions, and are an unknown of the cell.

use faer::Mat;
use nalgebra::Vector3;

use super::measured_scan::MeasuredScan;
use super::position_history::{PositionHistory, TimedSample};
use super::scan_cells::{FittedScanSphere, group_by_cell};
use super::setup::LaserSetup;
use crate::{IdentifyError, MethodRefusal};
use estimation::linear_least_squares::cholesky_lower;
use estimation::null_space_names::name_null_space;
use estimation::schur::{BlockFactorisation, BlockRows, factorise_and_project_right_side};
use machine::Axis;

/// Assumed standard uncertainty of one sample, mm. The result is scaled to the observed scatter.
const ASSUMED_SAMPLE_STD_U_MM: f64 = 1e-3;
/// A smaller standard uncertainty of a sample is replaced by this one, which limits its weight, mm.
const SAMPLE_STD_U_FLOOR_MM: f64 = 1e-6;
/// Maximum number of iterations, each with newly interpolated positions. If it is reached, the fit is refused.
const MAX_LATENCY_ITERATIONS: usize = 30;
/// The iteration ends when the latency changes by less than this, s, or by less than [`LATENCY_TOLERANCE_RATIO`]
/// allows.
const LATENCY_TOLERANCE_S: f64 = 1e-8;
/// Fraction of the standard uncertainty of the latency; a smaller change also ends the iteration.
const LATENCY_TOLERANCE_RATIO: f64 = 0.05;
/// Number of first iterations, in each of which the reliable samples are selected again. Later the selection is
/// fixed, otherwise some samples would alternate between iterations.
const SAMPLE_SELECTION_ITERATIONS: usize = 4;
/// Largest ratio by which the other unknowns may increase an unknown's uncertainty. Beyond it the unknown counts as
/// not separable. For two feeds in the ratio r, r > 1, it is (r + 1)/(r − 1).
const MAX_UNCERTAINTY_INFLATION: f64 = 5.5;

/// Estimated latency and lost motion.
#[derive(Debug, Clone)]
pub struct LatencyEstimate {
    /// Latency τ, s: the value stamped t + τ belongs to the position stamped t.
    pub latency_s: f64,
    /// Linear axes that moved.
    pub moved_axes: Vec<Axis>,
    /// Lag of X, Y and Z behind the indicated position after a forward motion, minus the lag after a backward motion,
    /// mm. Lost motion is positive; 0: unknown.
    pub lost_motion_mm: Vector3<f64>,
    /// Lower root of the covariance of τ (s) and of the lags of `moved_axes` (mm).
    pub covariance_root: Mat<f64>,
    /// Number of samples of the estimate.
    pub sample_count: usize,
}

/// A continuous scan with its samples.
pub struct TimedScan<'a> {
    pub scan: &'a MeasuredScan,
    pub position_history: &'a PositionHistory,
}

impl LatencyEstimate {
    /// True positions of the axes, corrected for lost motion.
    pub fn corrected_xyz(&self, xyz: Vector3<f64>, last_motion_sign: Vector3<f64>) -> Vector3<f64> {
        xyz - self.lost_motion_mm.component_mul(&last_motion_sign) / 2.0
    }

    /// Derivatives of the true position by τ (per s) and by the lags (per mm).
    pub fn position_derivatives(&self, velocity: Vector3<f64>, last_motion_sign: Vector3<f64>) -> Vec<Vector3<f64>> {
        let lags = self.moved_axes.iter().map(|axis| half_lag_direction(*axis, last_motion_sign));
        std::iter::once(-velocity).chain(lags.map(|half| -half)).collect()
    }

    /// Values in the order of the names, s and mm.
    pub fn values_of_unknowns(&self) -> Vec<f64> {
        let lags = self.moved_axes.iter().map(|axis| self.lost_motion_mm.dot(&axis.nominal_direction()));
        std::iter::once(self.latency_s).chain(lags).collect()
    }
}

/// Derivative of the lag by the lost motion of the axis: half of it, along the last motion.
fn half_lag_direction(axis: Axis, last_motion_sign: Vector3<f64>) -> Vector3<f64> {
    axis.nominal_direction().component_mul(&last_motion_sign) / 2.0
}

/// # Errors
/// No sample is on the sphere, the passes do not separate latency and lags, or the iteration does not converge.
pub fn fit_latency(setup: &LaserSetup<'_>, scans: &[TimedScan<'_>]) -> Result<LatencyEstimate, IdentifyError> {
    let (mut latency_s, mut reliable_samples) = (0.0, Vec::new());
    for number in 0..MAX_LATENCY_ITERATIONS {
        if number < SAMPLE_SELECTION_ITERATIONS {
            reliable_samples = scans.iter().map(|scan| ReliableSamples::new(setup, scan, latency_s)).collect();
        }
        let iteration = LatencyIteration::new(setup, &reliable_samples, latency_s)?;
        let (factored, x) = iteration.solve()?;
        let change_s = x.first().copied().unwrap_or(f64::NAN);
        latency_s += change_s;
        if !latency_s.is_finite() {
            break;
        }
        let estimate = iteration.into_estimate(latency_s, &factored, &x);
        let u_s = estimate.covariance_root[(0, 0)];
        if number + 1 >= SAMPLE_SELECTION_ITERATIONS
            && change_s.abs() < LATENCY_TOLERANCE_S.max(LATENCY_TOLERANCE_RATIO * u_s)
        {
            return Ok(estimate);
        }
    }
    Err(MethodRefusal::new(
        "the latency between sensor and axis positions does not converge",
        "check that the time stamps of sensor and axis positions are evenly spaced (`trued watch` lists those of the \
         sensor) and measure again, or measure with dwell points: sampling = \"dwell\"",
    )
    .into())
}

/// The reliable samples of one scan, by cells.
struct ReliableSamples<'a> {
    timed_scan: &'a TimedScan<'a>,
    samples_by_cell: Vec<Vec<TimedSample>>,
}

impl<'a> ReliableSamples<'a> {
    fn new(setup: &LaserSetup<'_>, timed_scan: &'a TimedScan<'a>, latency_s: f64) -> Self {
        let samples = timed_scan.position_history.timed_samples(latency_s);
        let cells = group_by_cell(setup, &samples).into_iter();
        Self { timed_scan, samples_by_cell: cells.map(|all| all.into_iter().copied().collect()).collect() }
    }

    fn samples_with_latency(&self, latency_s: f64) -> Vec<Vec<TimedSample>> {
        let sample_at = |sample: &TimedSample| self.timed_scan.position_history.sample_at_latency(sample, latency_s);
        self.samples_by_cell.iter().map(|all| all.iter().filter_map(sample_at).collect()).collect()
    }
}

/// The samples with their positions for one value of the latency.
struct LatencyIteration {
    moved_axes: Vec<Axis>,
    /// Rows of each cell, from the samples of one scan.
    rows_by_cell: Vec<Vec<LatencyRow>>,
}

/// Equation of one sample.
struct LatencyRow {
    /// Reading minus the reading predicted from the fitted sphere, mm.
    deviation_mm: f64,
    /// Derivatives of `deviation_mm` by the true τ (per s) and the true lags (per mm), at the assumed latency.
    deviation_derivatives: Vec<f64>,
}

impl LatencyIteration {
    /// # Errors
    /// There are too few samples.
    fn new(
        setup: &LaserSetup<'_>,
        reliable_samples: &[ReliableSamples<'_>],
        latency_s: f64,
    ) -> Result<Self, IdentifyError> {
        let all = || reliable_samples.iter().flat_map(|reliable| reliable.samples_by_cell.iter().flatten());
        let has_moved = |k: usize| all().any(|sample| sample.last_motion_sign[k] != 0.0);
        let axes = Axis::LINEAR.into_iter().enumerate().filter(|(k, _)| has_moved(*k));
        let axes: Vec<Axis> = axes.map(|(_, axis)| axis).collect();
        let mut cells: Vec<Vec<LatencyRow>> = Vec::new();
        for reliable in reliable_samples {
            let (scan, timed_cells) = (reliable.timed_scan.scan, reliable.samples_with_latency(latency_s));
            let samples = timed_cells.concat();
            let Some(sphere) = FittedScanSphere::fit(setup, scan, &samples) else { continue };
            for all in &timed_cells {
                let rows = all.iter().filter_map(|sample| {
                    let deviation_mm = sphere.deviation_mm(sample)?;
                    let slope = sphere.reading_gradient(sample.xyz)?;
                    let lags = axes.iter().map(|axis| slope.dot(&half_lag_direction(*axis, sample.last_motion_sign)));
                    let columns = std::iter::once(slope.dot(&sample.velocity)).chain(lags);
                    Some(LatencyRow { deviation_mm, deviation_derivatives: columns.map(|by| -by).collect() })
                });
                cells.push(rows.collect());
            }
        }
        cells.retain(|rows| !rows.is_empty());
        let samples: usize = cells.iter().map(Vec::len).sum();
        MethodRefusal::require(
            samples > 2 * cells.len() + 2 * axes.len(),
            format!(
                "{samples} samples of the stage `latency` are usable: too few for the latency of the sensor, which \
                 continuous scans need"
            ),
            LATENCY_REMEDY,
        )?;
        Ok(Self { moved_axes: axes, rows_by_cell: cells })
    }

    /// Number of unknowns that all cells share. Each cell has one more, which is not counted.
    fn common_unknown_count(&self) -> usize {
        1 + self.moved_axes.len()
    }

    /// The rows of each cell with the cell's own unknown.
    fn row_blocks(&self) -> Vec<BlockRows> {
        let block = |rows: &Vec<LatencyRow>| {
            let mut block = BlockRows::zeros(rows.len(), 1, self.common_unknown_count());
            for (i, row) in rows.iter().enumerate() {
                block.set_own_coefficient(i, 0, 1.0 / ASSUMED_SAMPLE_STD_U_MM);
                block.set_right_side(i, row.deviation_mm / ASSUMED_SAMPLE_STD_U_MM);
                let columns = row.deviation_derivatives.iter().enumerate();
                columns.for_each(|(j, by)| block.set_common_coefficient(i, j, by / ASSUMED_SAMPLE_STD_U_MM));
            }
            block
        };
        self.rows_by_cell.iter().map(block).collect()
    }

    fn weighted_deviations(&self) -> Vec<f64> {
        self.rows_by_cell.iter().flatten().map(|row| row.deviation_mm / ASSUMED_SAMPLE_STD_U_MM).collect()
    }

    /// Returns the factorisation and the unknowns.
    ///
    /// # Errors
    /// Unknowns are not separable, or are separated only by the acceleration ramps.
    fn solve(&self) -> Result<(BlockFactorisation, Vec<f64>), IdentifyError> {
        let (factored, _) = factorise_and_project_right_side(self.row_blocks());
        let survey = factored.analyse_rank().map_err(|why| IdentifyError::IdentificationFailed(why.to_string()))?;
        let mut names = latency_unknown_names(&self.moved_axes);
        names.extend((0..self.rows_by_cell.len()).map(|cell| format!("cell_{cell}")));
        let rank = format!("rank {} of {}", survey.rank, survey.rank + survey.nullity);
        if survey.nullity > 0 {
            let lost = name_null_space(survey.null_space.as_ref(), &names);
            return Err(not_separable_error(&rank, lost));
        }
        let (covariance, alone) = (factored.covariance(), factored.column_norms());
        let inflated = |k: &usize| covariance[(*k, *k)].sqrt() * alone[*k] > MAX_UNCERTAINTY_INFLATION;
        let weak: Vec<String> =
            (0..self.common_unknown_count()).filter(inflated).filter_map(|k| names.get(k).cloned()).collect();
        if !weak.is_empty() {
            return Err(not_separable_error(&format!("{rank}, but nearly singular"), weak));
        }
        let x = factored.solve(&self.weighted_deviations());
        Ok((factored, x))
    }

    fn into_estimate(self, latency_s: f64, factored: &BlockFactorisation, x: &[f64]) -> LatencyEstimate {
        let samples: usize = self.rows_by_cell.iter().map(Vec::len).sum();
        let chi2: f64 = factored.residuals(&self.weighted_deviations()).iter().map(|rest| rest * rest).sum();
        let dof = samples.saturating_sub(factored.unknown_count()).max(1) as f64;
        let scale = (chi2 / dof).max((SAMPLE_STD_U_FLOOR_MM / ASSUMED_SAMPLE_STD_U_MM).powi(2));
        let (covariance, count) = (factored.covariance(), self.common_unknown_count());
        let own = Mat::from_fn(count, count, |i, j| scale * covariance[(i, j)]);
        let lags = self.moved_axes.iter().zip(x.iter().skip(1));
        LatencyEstimate {
            latency_s,
            lost_motion_mm: lags.map(|(axis, by)| axis.nominal_direction() * *by).sum(),
            covariance_root: cholesky_lower(&own),
            sample_count: samples,
            moved_axes: self.moved_axes,
        }
    }
}

/// Names of τ and of the lags of `axes`.
pub fn latency_unknown_names(axes: &[Axis]) -> Vec<String> {
    let lags = axes.iter().map(|axis| format!("reversal_{axis}"));
    std::iter::once("latency".to_owned()).chain(lags).collect()
}

const LATENCY_REMEDY: &str = "measure the complete stage `latency`: both lines forward and \
                              backward, at feed_mm_min and at a fast_feed_mm_min of at least 1.5 \
                              times feed_mm_min; or measure again with sampling = \"dwell\"";

/// Refusal that names the latency and lost-motion unknowns that are not separable.
fn not_separable_error(rank: &str, names: Vec<String>) -> IdentifyError {
    let is_latency_unknown = |name: &&String| name.contains("latency") || name.contains("reversal");
    let names = names.iter().filter(is_latency_unknown).map(|name| names_without_cells(name));
    MethodRefusal::new(
        format!(
            "{rank}: the passes do not separate the latency of the sensor from the lost motion of the axes at \
             reversals ({})",
            names.collect::<Vec<_>>().join(", ")
        ),
        LATENCY_REMEDY,
    )
    .into()
}

/// Names of the latency and of the reversal errors in a combination of unknowns.
fn names_without_cells(combination: &str) -> String {
    let parts = combination.split(|c: char| c.is_whitespace() || "+-:=()".contains(c));
    let names = parts.filter(|word| word.starts_with("latency") || word.starts_with("reversal"));
    names.collect::<Vec<_>>().join(" and ")
}
