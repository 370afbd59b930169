//! Statistics of a block of trials, and of several blocks joined in order.

use faer::Mat;

use super::{TrialStatistics, numerical_tolerance};
use crate::coverage::COVERAGE_PROBABILITY;

/// Moments and coverage intervals of each output in one block of trials.
pub(super) struct TrialBlockStatistics {
    trial_count: usize,
    mean: Vec<f64>,
    /// Scatter matrix Σ(x − mean)(x − mean)ᵀ.
    scatter_matrix: Mat<f64>,
    symmetric_intervals: Vec<[f64; 2]>,
    shortest_intervals: Vec<[f64; 2]>,
}

impl TrialBlockStatistics {
    /// Computes the statistics from the values of the outputs, trials × outputs.
    pub(super) fn new(values: Mat<f64>) -> Self {
        let (trials, outputs) = (values.nrows(), values.ncols());
        let mut deviations = values;
        let mut mean = Vec::with_capacity(outputs);
        let mut symmetric_intervals = Vec::with_capacity(outputs);
        let mut shortest_intervals = Vec::with_capacity(outputs);
        let mut sorted = vec![0.0; trials];
        for j in 0..outputs {
            let column = deviations.col_mut(j);
            for (copy, value) in sorted.iter_mut().zip(column.as_ref().iter()) {
                *copy = *value;
            }
            let average = sorted.iter().sum::<f64>() / trials as f64;
            column.iter_mut().for_each(|value| *value -= average);
            mean.push(average);
            sorted.sort_unstable_by(f64::total_cmp);
            symmetric_intervals.push(symmetric_interval(&sorted, COVERAGE_PROBABILITY));
            shortest_intervals.push(shortest_interval(&sorted, COVERAGE_PROBABILITY));
        }
        let scatter = deviations.transpose() * &deviations;
        Self { trial_count: trials, mean, scatter_matrix: scatter, symmetric_intervals, shortest_intervals }
    }

    fn standard_deviation(&self, output: usize) -> f64 {
        (self.scatter_matrix[(output, output)] / (self.trial_count.max(2) - 1) as f64).sqrt()
    }
}

/// Probabilistically symmetric interval (JCGM 101, 7.7.2): ranks r and r + q of the M sorted values, q = p·M,
/// r = (M − q)/2, rounded.
fn symmetric_interval(sorted: &[f64], probability: f64) -> [f64; 2] {
    let count = sorted.len();
    let covered = covered_count(count, probability);
    let low_rank = (count - covered).div_ceil(2).max(1);
    [sorted[low_rank - 1], sorted[(low_rank + covered).min(count) - 1]]
}

/// Shortest of all intervals between ranks r and r + q of the sorted values, q = p·M (JCGM 101, 7.7.4).
pub(super) fn shortest_interval(sorted: &[f64], probability: f64) -> [f64; 2] {
    let covered = covered_count(sorted.len(), probability);
    let pairs = sorted.iter().zip(&sorted[covered..]);
    let shortest = pairs.min_by(|a, b| (a.1 - a.0).total_cmp(&(b.1 - b.0)));
    shortest.map_or([f64::NAN; 2], |(low, high)| [*low, *high])
}

/// Number of values in the interval: q of JCGM 101, 7.7.
fn covered_count(count: usize, probability: f64) -> usize {
    ((probability * count as f64 + 0.5) as usize).min(count - 1)
}

/// Blocks joined in the order in which they are pushed.
pub(super) struct MergedTrialBlocks {
    trial_count: usize,
    mean: Vec<f64>,
    scatter_matrix: Mat<f64>,
    blocks: Vec<TrialBlockStatistics>,
}

impl MergedTrialBlocks {
    pub(super) fn new(outputs: usize) -> Self {
        let scatter = Mat::zeros(outputs, outputs);
        Self { trial_count: 0, mean: vec![0.0; outputs], scatter_matrix: scatter, blocks: Vec::new() }
    }

    /// Adds a block. The moments are merged with those of the earlier blocks (Chan, Golub, LeVeque 1979).
    pub(super) fn push(&mut self, block: TrialBlockStatistics) {
        let (before, added) = (self.trial_count as f64, block.trial_count as f64);
        let total = before + added;
        let shift: Vec<f64> = block.mean.iter().zip(&self.mean).map(|(b, m)| b - m).collect();
        let weight = before * added / total;
        self.scatter_matrix +=
            &block.scatter_matrix + Mat::from_fn(shift.len(), shift.len(), |i, j| weight * shift[i] * shift[j]);
        for (mean, shift) in self.mean.iter_mut().zip(&shift) {
            *mean += shift * added / total;
        }
        self.trial_count += block.trial_count;
        self.blocks.push(block);
    }

    /// Stopping rule (JCGM 101, 7.9.4): there are at least two blocks, and for every output, twice the standard
    /// deviation of each block average (of mean, standard deviation and both ends of the symmetric interval) is within
    /// the numerical tolerance.
    pub(super) fn is_stable(&self, digits: u32) -> bool {
        self.blocks.len() >= 2
            && (0..self.mean.len()).all(|j| {
                let tolerance = numerical_tolerance(self.standard_deviation(j), digits);
                let steady = |of: &dyn Fn(&TrialBlockStatistics) -> f64| {
                    2.0 * standard_deviation_of_mean(self.blocks.iter().map(of)) <= tolerance
                };
                steady(&|block| block.mean[j])
                    && steady(&|block| block.standard_deviation(j))
                    && steady(&|block| block.symmetric_intervals[j][0])
                    && steady(&|block| block.symmetric_intervals[j][1])
            })
    }

    pub(super) fn into_statistics(self, is_stable: bool) -> TrialStatistics {
        let outputs = self.mean.len();
        let freedom = (self.trial_count.max(2) - 1) as f64;
        let end = |of: &dyn Fn(&TrialBlockStatistics) -> f64| {
            let weighted = self.blocks.iter().map(|block| of(block) * block.trial_count as f64);
            weighted.sum::<f64>() / self.trial_count as f64
        };
        let ends = |of: fn(&TrialBlockStatistics) -> &Vec<[f64; 2]>| -> Vec<[f64; 2]> {
            let side = |j: usize, side: usize| end(&|block| of(block)[j][side]);
            (0..outputs).map(|j| [side(j, 0), side(j, 1)]).collect()
        };
        TrialStatistics {
            trial_count: self.trial_count,
            is_stable,
            standard_deviation: (0..outputs).map(|j| self.standard_deviation(j)).collect(),
            covariance: Mat::from_fn(outputs, outputs, |i, j| self.scatter_matrix[(i, j)] / freedom),
            symmetric_interval: ends(|block| &block.symmetric_intervals),
            shortest_interval: ends(|block| &block.shortest_intervals),
            mean: self.mean,
        }
    }

    /// Standard deviation of one output over the trials of all blocks.
    fn standard_deviation(&self, output: usize) -> f64 {
        (self.scatter_matrix[(output, output)] / (self.trial_count.max(2) - 1) as f64).sqrt()
    }
}

/// Standard deviation of the mean of the values: their standard deviation divided by √count.
fn standard_deviation_of_mean(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / count;
    let squares: f64 = values.map(|value| (value - mean).powi(2)).sum();
    (squares / (count * (count - 1.0))).sqrt()
}
