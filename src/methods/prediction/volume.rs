//! Error of the tip over the whole volume: largest and mean, with their uncertainty.

use estimation::coverage::COVERAGE_PROBABILITY;
use estimation::linear::lower_root;
use estimation::monte_carlo::{Random, Shape};
use estimation::rigid::RigidFit;
use nalgebra::Vector3;
use rayon::prelude::*;

use super::{Predictor, TipError};
use crate::Refused;
use machine::{Axis, Position};

/// Number of positions of a linear axis over its range, and largest step of a rotary axis, degrees.
const LINEAR_POSITIONS: usize = 5;
const ROTARY_STEP_DEG: f64 = 30.0;
/// Minimum and maximum number of draws of the errors. The number is chosen so that the computation takes
/// about a second; u is then accurate to 2 to 7 %.
const TRIALS: [usize; 2] = [100, 1000];
const POSES_OF_ALL_TRIALS: usize = 4_000_000;
const SEED: u64 = 0x766f_6c75;

/// Errors over a set of poses, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VolumeError {
    pub largest_mm: f64,
    pub u_largest_mm: f64,
    pub mean_mm: f64,
    pub u_mean_mm: f64,
    /// Upper bounds of the errors with the probability [`COVERAGE_PROBABILITY`], mm, for errors that were
    /// estimated to be 0.
    pub largest_95_mm: f64,
    pub mean_95_mm: f64,
    /// Index of the pose with the largest error.
    pub worst: usize,
}

impl Predictor<'_> {
    /// A grid over the ranges of the axes over which the estimate was measured; the spindle is at 0.
    ///
    /// # Errors
    /// The estimate does not state the ranges over which it was measured.
    pub fn volume(&self) -> Result<Vec<Position>, Refused> {
        self.check_ranges()?;
        let mut poses = vec![Position::new()];
        for (axis, [least, most]) in self.measured.iter().filter(|(axis, _)| **axis != Axis::S) {
            let count = match axis.is_linear() {
                _ if least == most => 1,
                true => LINEAR_POSITIONS,
                false => ((most - least) / ROTARY_STEP_DEG).ceil() as usize + 1,
            };
            let step = (most - least) / (count - 1).max(1) as f64;
            let at = |k: usize| axis.from_edge(least + k as f64 * step);
            let with = |pose: &Position| {
                (0..count).map(|k| pose.clone().with(*axis, at(k))).collect::<Vec<_>>()
            };
            poses = poses.iter().flat_map(with).collect();
        }
        Ok(poses)
    }

    /// Errors relative to the work zero, and after a best fit of the workpiece; u comes from draws of the
    /// estimate's errors.
    pub fn volume_errors(&self, poses: &[Position], tips: &[TipError]) -> [VolumeError; 2] {
        let zeroed: Vec<Vector3<f64>> = tips.iter().map(|tip| tip.mm).collect();
        let fit = self.best_fit(poses, &zeroed);
        let root = lower_root(&self.known.covariance);
        let count = root.ncols();
        let trials = (POSES_OF_ALL_TRIALS / poses.len().max(1)).clamp(TRIALS[0], TRIALS[1]);
        let units = Random::of(SEED, &[]).units(trials, &vec![Shape::Normal; count]);
        let changed = |trial: usize| {
            let unit = |draw: usize| units[draw * trials + trial];
            let change =
                |j: usize| (0..count).map(|draw| root[(j, draw)] * unit(draw)).sum::<f64>();
            let errors: Vec<f64> = (0..root.nrows()).map(change).collect();
            let moved = tips.iter().map(|tip| {
                tip.columns.iter().zip(&errors).map(|(column, error)| column * *error).sum()
            });
            let mut moved: Vec<Vector3<f64>> = moved.collect();
            let against_zero = sizes(&zeroed, &moved);
            fit.without_rigid(&mut moved);
            [against_zero, sizes(&fit.deviations, &moved)]
        };
        let trials: Vec<[[f64; 2]; 2]> = (0..trials).into_par_iter().map(changed).collect();
        [(0, &zeroed), (1, &fit.deviations)].map(|(k, deviations)| {
            let still = vec![Vector3::zeros(); deviations.len()];
            let [largest_mm, mean_mm] = sizes(deviations, &still);
            let of_trials = |of: usize| trials.iter().map(move |trial| trial[k][of]);
            let u = |of: usize| deviation(of_trials(of));
            let worst = (0..deviations.len())
                .max_by(|a, b| deviations[*a].norm().total_cmp(&deviations[*b].norm()));
            VolumeError {
                largest_mm,
                u_largest_mm: u(0),
                mean_mm,
                u_mean_mm: u(1),
                largest_95_mm: covering(of_trials(0)),
                mean_95_mm: covering(of_trials(1)),
                worst: worst.unwrap_or_default(),
            }
        })
    }

    /// Results of [`Predictor::volume_errors`] in words.
    pub fn in_words(errors: [VolumeError; 2], poses: &[Position]) -> Vec<String> {
        let names = ["against the work zero", "after a best fit of the workpiece"];
        let line = |(what, error): (&str, VolumeError)| {
            let VolumeError { largest_mm, u_largest_mm, mean_mm, u_mean_mm, worst, .. } = error;
            format!(
                "error of the tip {what}: largest ({:.1} ± {:.1}) µm at {}, mean ({:.1} ± {:.1}) µm (U, k = 2)",
                largest_mm * 1e3,
                2e3 * u_largest_mm,
                pose_in_words(&poses[worst]),
                mean_mm * 1e3,
                2e3 * u_mean_mm
            )
        };
        // Fewer than three points always fit.
        let shown = if poses.len() < 3 { 1 } else { 2 };
        names.into_iter().zip(errors).take(shown).map(line).collect()
    }

    /// Errors that may remain relative to the work zero after a correction of `symbols`, in words.
    ///
    /// # Errors
    /// A symbol is not an error of the estimate.
    pub fn left_in_words(self, symbols: &[&str], poses: &[Position]) -> Result<String, Refused> {
        let names = symbols.join(", ");
        let corrected = self.corrected(symbols)?;
        let [error, _] = corrected.volume_errors(poses, &corrected.tips(poses));
        Ok(format!(
            "after a correction of {names}: largest below {:.1} µm, mean below {:.1} µm (95.45 %)",
            error.largest_95_mm * 1e3,
            error.mean_95_mm * 1e3
        ))
    }

    /// Best fit of the workpiece by a rigid motion.
    fn best_fit(&self, poses: &[Position], errors: &[Vector3<f64>]) -> RigidFit {
        let place = |at: &Position| self.chain.tip_in_table(at, self.tip, &[]).mm;
        let nominal: Vec<Vector3<f64>> = poses.iter().map(place).collect();
        let off: Vec<Vector3<f64>> =
            nominal.iter().zip(errors).map(|(place, error)| place + error).collect();
        RigidFit::new(&nominal, &off)
    }
}

/// Largest and mean length of the changed deviations.
fn sizes(deviations: &[Vector3<f64>], changes: &[Vector3<f64>]) -> [f64; 2] {
    let norms = || deviations.iter().zip(changes).map(|(d, by)| (d + by).norm());
    [norms().fold(0.0, f64::max), norms().sum::<f64>() / deviations.len().max(1) as f64]
}

fn pose_in_words(at: &Position) -> String {
    let words = at.iter().map(|(axis, value)| format!("{axis}{:.3}", axis.to_edge(value)));
    words.collect::<Vec<_>>().join(" ")
}

fn covering(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted[(COVERAGE_PROBABILITY * (sorted.len() - 1) as f64).ceil() as usize]
}

/// Standard deviation of the values.
fn deviation(values: impl ExactSizeIterator<Item = f64> + Clone) -> f64 {
    let count = values.len() as f64;
    let mean = values.clone().sum::<f64>() / count;
    (values.map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0)).sqrt()
}
