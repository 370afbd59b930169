//! Error of the tip over the whole volume: largest and mean, with their uncertainty.

use estimation::coverage::COVERAGE_PROBABILITY;
use estimation::linear_least_squares::cholesky_lower;
use estimation::monte_carlo::{DrawDistribution, DrawStream};
use estimation::rigid_fit::RigidFit;
use nalgebra::Vector3;
use rayon::prelude::*;

use super::{ErrorPredictor, TipError};
use crate::MethodRefusal;
use crate::identification::parameter_without_budget;
use machine::record::estimate::{Parameter, Unit};
use machine::{Axis, Position};

/// Number of positions of a linear axis over its range.
const POSITIONS_PER_LINEAR_AXIS: usize = 5;
/// Largest step of a rotary axis, degrees.
const MAX_GRID_STEP_OF_ROTARY_AXIS_DEG: f64 = 30.0;
/// Minimum and maximum number of draws of the errors. The number is chosen so that the computation takes
/// about a second; u is then accurate to 2 to 7 %.
const TRIAL_COUNT_LIMITS: [usize; 2] = [100, 1000];
/// Maximum number of trials times poses. With more poses, the number of trials is reduced.
const MAX_TRIALS_TIMES_POSES: usize = 4_000_000;
const MONTE_CARLO_SEED: u64 = 0x766f_6c75;

/// Largest and mean error of the tip over a set of poses, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VolumeError {
    pub largest_mm: f64,
    /// Standard uncertainty: standard deviation over the draws of the errors.
    pub u_largest_mm: f64,
    /// Mean over the poses of the length of the tip error.
    pub mean_mm: f64,
    /// Standard uncertainty of the mean over the poses.
    pub u_mean_mm: f64,
    /// Quantile of the largest error over the draws at [`COVERAGE_PROBABILITY`], mm: upper bound of the largest error
    /// that remains after a correction of the estimated errors.
    pub largest_95_percent_bound_mm: f64,
    /// The same quantile of the mean error over the poses, mm.
    pub mean_95_percent_bound_mm: f64,
    /// Index of the pose with the largest error in the list of poses.
    pub worst_pose_index: usize,
}

/// Symbol of the largest position error of the tool over the volume; a limit for it is `E_vol_um` of `[tolerance]`.
pub const VOLUMETRIC_ERROR_SYMBOL: &str = "E_vol";

impl ErrorPredictor<'_> {
    /// Largest position error of the tool relative to the work zero over the grid poses, as a parameter of the
    /// estimate. A tolerance limit may apply to this parameter.
    ///
    /// # Errors
    /// The estimate does not state the ranges over which it was measured.
    pub fn volumetric_error_parameter(&self) -> Result<Parameter, MethodRefusal> {
        let poses = self.volume_grid_poses()?;
        let [VolumeError { largest_mm, u_largest_mm, .. }, _] = self.volume_errors(&poses, &self.tip_errors(&poses));
        Ok(parameter_without_budget(VOLUMETRIC_ERROR_SYMBOL, Unit::Um, largest_mm, u_largest_mm, None))
    }

    /// Poses on a grid over the ranges of the axes over which the estimate was measured; the spindle is at 0.
    ///
    /// # Errors
    /// The estimate does not state the ranges over which it was measured.
    pub fn volume_grid_poses(&self) -> Result<Vec<Position>, MethodRefusal> {
        self.check_has_measured_ranges()?;
        let mut poses = vec![Position::new()];
        for (axis, [least, most]) in self.measured_ranges.iter().filter(|(axis, _)| **axis != Axis::S) {
            let count = match axis.is_linear() {
                _ if least == most => 1,
                true => POSITIONS_PER_LINEAR_AXIS,
                false => ((most - least) / MAX_GRID_STEP_OF_ROTARY_AXIS_DEG).ceil() as usize + 1,
            };
            let step = (most - least) / (count - 1).max(1) as f64;
            let at = |k: usize| axis.to_mm_or_rad(least + k as f64 * step);
            let with = |pose: &Position| (0..count).map(|k| pose.clone().with(*axis, at(k))).collect::<Vec<_>>();
            poses = poses.iter().flat_map(with).collect();
        }
        Ok(poses)
    }

    /// Errors relative to the work zero, then after a best fit of the workpiece. u comes from draws of the estimate's
    /// errors.
    pub fn volume_errors(&self, poses: &[Position], tips: &[TipError]) -> [VolumeError; 2] {
        let zeroed: Vec<Vector3<f64>> = tips.iter().map(|tip| tip.error_mm).collect();
        let fit = self.fit_workpiece(poses, &zeroed);
        let root = cholesky_lower(&self.known_errors.covariance);
        let count = root.ncols();
        let trials = (MAX_TRIALS_TIMES_POSES / poses.len().max(1)).clamp(TRIAL_COUNT_LIMITS[0], TRIAL_COUNT_LIMITS[1]);
        let units = DrawStream::from_key(MONTE_CARLO_SEED, &[])
            .unit_variance_draws(trials, &vec![DrawDistribution::Normal; count]);
        let trial_errors = |trial: usize| {
            let unit = |draw: usize| units[draw * trials + trial];
            let change = |j: usize| (0..count).map(|draw| root[(j, draw)] * unit(draw)).sum::<f64>();
            let errors: Vec<f64> = (0..root.nrows()).map(change).collect();
            let moved =
                tips.iter().map(|tip| tip.derivatives.iter().zip(&errors).map(|(column, error)| column * *error).sum());
            let mut moved: Vec<Vector3<f64>> = moved.collect();
            let relative_to_zero = largest_and_mean_length(&zeroed, &moved);
            fit.subtract_rigid_motion(&mut moved);
            [relative_to_zero, largest_and_mean_length(&fit.deviations, &moved)]
        };
        let trials: Vec<[[f64; 2]; 2]> = (0..trials).into_par_iter().map(trial_errors).collect();
        [(0, &zeroed), (1, &fit.deviations)].map(|(k, deviations)| {
            let unchanged = vec![Vector3::zeros(); deviations.len()];
            let [largest_mm, mean_mm] = largest_and_mean_length(deviations, &unchanged);
            let of_trials = |index: usize| trials.iter().map(move |trial| trial[k][index]);
            let u = |index: usize| standard_deviation(of_trials(index));
            let worst = (0..deviations.len()).max_by(|a, b| deviations[*a].norm().total_cmp(&deviations[*b].norm()));
            VolumeError {
                largest_mm,
                u_largest_mm: u(0),
                mean_mm,
                u_mean_mm: u(1),
                largest_95_percent_bound_mm: quantile_at_coverage_probability(of_trials(0)),
                mean_95_percent_bound_mm: quantile_at_coverage_probability(of_trials(1)),
                worst_pose_index: worst.unwrap_or_default(),
            }
        })
    }

    /// Results of [`ErrorPredictor::volume_errors`] in words. With fewer than three poses, the line for the best fit is
    /// left out.
    pub fn describe_volume_errors(errors: [VolumeError; 2], poses: &[Position]) -> Vec<String> {
        let names = ["relative to the work zero", "after a best fit of the workpiece"];
        let line = |(reference, error): (&str, VolumeError)| {
            let VolumeError { largest_mm, u_largest_mm, mean_mm, u_mean_mm, worst_pose_index: worst_pose, .. } = error;
            format!(
                "error of the tip {reference}: largest ({:.1} ± {:.1}) µm at {}, mean ({:.1} ± {:.1}) µm (U, k = 2)",
                largest_mm * 1e3,
                2e3 * u_largest_mm,
                describe_pose(&poses[worst_pose]),
                mean_mm * 1e3,
                2e3 * u_mean_mm
            )
        };
        // Fewer than three points always fit.
        let line_count = if poses.len() < 3 { 1 } else { 2 };
        names.into_iter().zip(errors).take(line_count).map(line).collect()
    }

    /// Errors that may remain relative to the work zero after a correction of `symbols`, in words.
    ///
    /// # Errors
    /// A symbol is not an error of the estimate.
    pub fn describe_error_after_correction(
        self,
        symbols: &[&str],
        poses: &[Position],
    ) -> Result<String, MethodRefusal> {
        let names = symbols.join(", ");
        let corrected = self.with_corrected_errors(symbols)?;
        let [error, _] = corrected.volume_errors(poses, &corrected.tip_errors(poses));
        Ok(format!(
            "after a correction of {names}: largest below {:.1} µm, mean below {:.1} µm (95.45 %)",
            error.largest_95_percent_bound_mm * 1e3,
            error.mean_95_percent_bound_mm * 1e3
        ))
    }

    /// Best fit of the workpiece by a rigid motion.
    fn fit_workpiece(&self, poses: &[Position], errors: &[Vector3<f64>]) -> RigidFit {
        let position = |at: &Position| self.chain.tip_in_table(at, self.tip, &[]).mm;
        let nominal: Vec<Vector3<f64>> = poses.iter().map(position).collect();
        let measured: Vec<Vector3<f64>> =
            nominal.iter().zip(errors).map(|(position, error)| position + error).collect();
        RigidFit::new(&nominal, &measured)
    }
}

/// Largest and mean length of the changed deviations.
fn largest_and_mean_length(deviations: &[Vector3<f64>], changes: &[Vector3<f64>]) -> [f64; 2] {
    let norms = || deviations.iter().zip(changes).map(|(d, by)| (d + by).norm());
    [norms().fold(0.0, f64::max), norms().sum::<f64>() / deviations.len().max(1) as f64]
}

fn describe_pose(at: &Position) -> String {
    let axes = at.iter().map(|(axis, value)| format!("{axis}{:.3}", axis.to_mm_or_deg(value)));
    axes.collect::<Vec<_>>().join(" ")
}

/// Quantile of the values at [`COVERAGE_PROBABILITY`].
fn quantile_at_coverage_probability(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted[(COVERAGE_PROBABILITY * (sorted.len() - 1) as f64).ceil() as usize]
}

/// Standard deviation of the values.
fn standard_deviation(values: impl ExactSizeIterator<Item = f64> + Clone) -> f64 {
    let count = values.len() as f64;
    let mean = values.clone().sum::<f64>() / count;
    (values.map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0)).sqrt()
}
