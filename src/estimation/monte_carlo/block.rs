//! Statistics of a block of trials, and of blocks joined in order.

use faer::Mat;

use super::{Summary, numerical_tolerance};
use crate::coverage::COVERAGE_PROBABILITY;

/// One block: moments and interval of each output.
pub(super) struct Block {
    trials: usize,
    mean: Vec<f64>,
    /// Σ(x − mean)(x − mean)ᵀ.
    scatter: Mat<f64>,
    interval: Vec<[f64; 2]>,
}

impl Block {
    /// From the values of the outputs, trials × outputs.
    pub(super) fn new(values: Mat<f64>) -> Self {
        let (trials, outputs) = (values.nrows(), values.ncols());
        let mut deviations = values;
        let mut mean = Vec::with_capacity(outputs);
        let mut interval = Vec::with_capacity(outputs);
        let mut sorted = vec![0.0; trials];
        for j in 0..outputs {
            let column = deviations.col_mut(j);
            for (copy, value) in sorted.iter_mut().zip(column.as_ref().iter()) {
                *copy = *value;
            }
            let average = sorted.iter().sum::<f64>() / trials as f64;
            column.iter_mut().for_each(|value| *value -= average);
            mean.push(average);
            interval.push(symmetric_interval(&mut sorted));
        }
        let scatter = deviations.transpose() * &deviations;
        Self { trials, mean, scatter, interval }
    }

    fn deviation(&self, output: usize) -> f64 {
        (self.scatter[(output, output)] / (self.trials.max(2) - 1) as f64).sqrt()
    }
}

/// JCGM 101, 7.7.2: ranks r and r + q of the sorted values, q = p·M, r = (M − q)/2, rounded.
fn symmetric_interval(values: &mut [f64]) -> [f64; 2] {
    let count = values.len();
    let covered = ((COVERAGE_PROBABILITY * count as f64 + 0.5) as usize).min(count - 1);
    let low_rank = (count - covered).div_ceil(2).max(1);
    let mut ranked = |rank: usize| *values.select_nth_unstable_by(rank - 1, f64::total_cmp).1;
    [ranked(low_rank), ranked((low_rank + covered).min(count))]
}

/// Blocks joined in the order in which they are pushed.
pub(super) struct Joined {
    trials: usize,
    mean: Vec<f64>,
    scatter: Mat<f64>,
    blocks: Vec<Block>,
}

impl Joined {
    pub(super) fn new(outputs: usize) -> Self {
        let scatter = Mat::zeros(outputs, outputs);
        Self { trials: 0, mean: vec![0.0; outputs], scatter, blocks: Vec::new() }
    }

    /// Moments are merged pairwise (Chan, Golub, LeVeque 1979).
    pub(super) fn push(&mut self, block: Block) {
        let (before, added) = (self.trials as f64, block.trials as f64);
        let total = before + added;
        let shift: Vec<f64> = block.mean.iter().zip(&self.mean).map(|(b, m)| b - m).collect();
        let weight = before * added / total;
        self.scatter += &block.scatter
            + Mat::from_fn(shift.len(), shift.len(), |i, j| weight * shift[i] * shift[j]);
        for (mean, shift) in self.mean.iter_mut().zip(&shift) {
            *mean += shift * added / total;
        }
        self.trials += block.trials;
        self.blocks.push(block);
    }

    /// JCGM 101, 7.9.4: twice the standard deviation of each block average (of mean, standard
    /// deviation, both interval ends) within the numerical tolerance, for every output.
    pub(super) fn is_stable(&self, digits: u32) -> bool {
        self.blocks.len() >= 2
            && (0..self.mean.len()).all(|j| {
                let tolerance = numerical_tolerance(self.deviation(j), digits);
                let steady = |of: &dyn Fn(&Block) -> f64| {
                    2.0 * deviation_of_average(self.blocks.iter().map(of)) <= tolerance
                };
                steady(&|block| block.mean[j])
                    && steady(&|block| block.deviation(j))
                    && steady(&|block| block.interval[j][0])
                    && steady(&|block| block.interval[j][1])
            })
    }

    pub(super) fn summary(self, stable: bool) -> Summary {
        let outputs = self.mean.len();
        let freedom = (self.trials.max(2) - 1) as f64;
        let end = |j: usize, side: usize| {
            let weighted = self.blocks.iter().map(|b| b.interval[j][side] * b.trials as f64);
            weighted.sum::<f64>() / self.trials as f64
        };
        Summary {
            trials: self.trials,
            stable,
            standard_deviation: (0..outputs).map(|j| self.deviation(j)).collect(),
            covariance: Mat::from_fn(outputs, outputs, |i, j| self.scatter[(i, j)] / freedom),
            interval: (0..outputs).map(|j| [end(j, 0), end(j, 1)]).collect(),
            mean: self.mean,
        }
    }

    fn deviation(&self, output: usize) -> f64 {
        (self.scatter[(output, output)] / (self.trials.max(2) - 1) as f64).sqrt()
    }
}

fn deviation_of_average(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / count;
    let squares: f64 = values.map(|value| (value - mean).powi(2)).sum();
    (squares / (count * (count - 1.0))).sqrt()
}
