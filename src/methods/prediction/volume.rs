//! The error of the tip over the whole volume: largest and mean, with their uncertainty.

use estimation::linear::lower_root;
use estimation::monte_carlo::{Random, Shape};
use estimation::rigid::RigidFit;
use nalgebra::Vector3;
use rayon::prelude::*;

use super::Predictor;
use crate::Refused;
use machine::{Axis, Position};

/// Positions of a linear axis over its range, and the largest step of a rotary one, degrees.
const LINEAR_POSITIONS: usize = 5;
const ROTARY_STEP_DEG: f64 = 30.0;
/// Draws of the errors: u to about 5 %.
const TRIALS: usize = 200;
const SEED: u64 = 0x766f_6c75;

/// Over a set of poses, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VolumeError {
    pub largest_mm: f64,
    pub u_largest_mm: f64,
    pub mean_mm: f64,
    pub u_mean_mm: f64,
    /// Index of the pose of the largest error.
    pub worst: usize,
}

impl Predictor<'_> {
    /// A grid over the ranges of the axes that the estimate was measured over; the spindle stands at 0.
    ///
    /// # Errors
    /// The estimate does not say what it was measured over.
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

    /// Against the work zero, and after a best fit of the workpiece; u from draws of the estimate's errors.
    pub fn volume_errors(&self, poses: &[Position]) -> [VolumeError; 2] {
        let errors = self.at_all(poses);
        let zeroed: Vec<Vector3<f64>> = errors.iter().map(|error| error.tip_mm).collect();
        let columns: Vec<Vec<Vector3<f64>>> =
            poses.par_iter().map(|at| self.zeroed_columns(at)).collect();
        let fit = self.best_fit(poses, &errors);
        let root = lower_root(&self.known.covariance);
        let count = root.ncols();
        let units = Random::of(SEED, &[]).units(TRIALS, &vec![Shape::Normal; count]);
        let changed = |trial: usize| {
            let unit = |draw: usize| units[draw * TRIALS + trial];
            let change =
                |j: usize| (0..count).map(|draw| root[(j, draw)] * unit(draw)).sum::<f64>();
            let errors: Vec<f64> = (0..root.nrows()).map(change).collect();
            let moved = columns.iter().map(|columns| {
                columns.iter().zip(&errors).map(|(column, error)| column * *error).sum()
            });
            let mut moved: Vec<Vector3<f64>> = moved.collect();
            let against_zero = sizes(&zeroed, &moved);
            fit.without_rigid(&mut moved);
            [against_zero, sizes(&fit.deviations, &moved)]
        };
        let trials: Vec<[[f64; 2]; 2]> = (0..TRIALS).into_par_iter().map(changed).collect();
        [(0, &zeroed), (1, &fit.deviations)].map(|(k, deviations)| {
            let still = vec![Vector3::zeros(); deviations.len()];
            let [largest_mm, mean_mm] = sizes(deviations, &still);
            let u = |of: usize| deviation(trials.iter().map(|trial| trial[k][of]));
            let worst = (0..deviations.len())
                .max_by(|a, b| deviations[*a].norm().total_cmp(&deviations[*b].norm()));
            VolumeError {
                largest_mm,
                u_largest_mm: u(0),
                mean_mm,
                u_mean_mm: u(1),
                worst: worst.unwrap_or_default(),
            }
        })
    }

    /// Of the workpiece, by a rigid motion.
    fn best_fit(&self, poses: &[Position], errors: &[super::PoseError]) -> RigidFit {
        let place = |at: &Position| self.chain.tip_in_table(at, self.tip, &[]).mm;
        let nominal: Vec<Vector3<f64>> = poses.iter().map(place).collect();
        let off: Vec<Vector3<f64>> =
            nominal.iter().zip(errors).map(|(place, error)| place + error.tip_mm).collect();
        RigidFit::new(&nominal, &off)
    }
}

/// Largest and mean length of the deviations with their changes.
fn sizes(deviations: &[Vector3<f64>], changes: &[Vector3<f64>]) -> [f64; 2] {
    let norms = || deviations.iter().zip(changes).map(|(d, by)| (d + by).norm());
    [norms().fold(0.0, f64::max), norms().sum::<f64>() / deviations.len().max(1) as f64]
}

/// Standard deviation.
fn deviation(values: impl ExactSizeIterator<Item = f64> + Clone) -> f64 {
    let count = values.len() as f64;
    let mean = values.clone().sum::<f64>() / count;
    (values.map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0)).sqrt()
}
