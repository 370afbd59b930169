//! Monte Carlo propagation of distributions (JCGM 101), many trials at a time: observations, unknowns and outputs
//! are columns over trials. The propagation is seeded: each chunk of trials draws from its own stream and the
//! results are joined in order, so the result is identical to the bit for any number of threads.

mod draw_stream;
mod trial_block;

use faer::Mat;
use rayon::prelude::*;

use trial_block::{MergedTrialBlocks, TrialBlockStatistics};

pub use draw_stream::DrawStream;

/// Minimum number of trials of a block, unless there are fewer trials in total. Coverage intervals are computed in each
/// block from its sorted values (JCGM 101, 7.9.4: at least 10⁴ trials for 95 %).
const MIN_TRIALS_PER_BLOCK: usize = 10_000;
/// Number of trials that share a random stream.
const TRIALS_PER_RANDOM_STREAM: usize = 1_000;
/// Number of trials computed by one call of `compute`: a divisor of [`TRIALS_PER_RANDOM_STREAM`].
const TRIALS_PER_CALL: usize = 200;
/// Number of blocks between two evaluations of the stopping rule.
const BLOCKS_PER_STABILITY_CHECK: usize = 4;

/// Distribution of one independent draw of unit variance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DrawDistribution {
    Normal,
    Rectangular,
}

/// Rule for the number of Monte Carlo trials.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrialCount {
    /// This number of trials, whether the results are stable or not.
    Fixed(usize),
    /// Blocks of 10⁴ trials until means, standard deviations and interval ends of all outputs are stable to
    /// `digits` significant digits of the standard deviation (JCGM 101, 7.9), or `max` trials.
    Adaptive { digits: u32, max: usize },
}

impl TrialCount {
    /// The requested number of trials, or the adaptive rule if `count` is 0.
    pub fn from_setting(count: usize, digits: u32, max: usize) -> Self {
        if count == 0 { Self::Adaptive { digits, max } } else { Self::Fixed(count) }
    }
}

/// Statistics of the trials, one entry per output.
#[derive(Debug, Clone)]
pub struct TrialStatistics {
    pub trial_count: usize,
    /// Whether the stopping rule of adaptive trials was met. Always `true` for a fixed number of trials.
    pub is_stable: bool,
    pub mean: Vec<f64>,
    /// Standard deviation of the trials, which is the standard uncertainty of the output.
    pub standard_deviation: Vec<f64>,
    /// Covariance of the outputs, outputs × outputs.
    pub covariance: Mat<f64>,
    /// Probabilistically symmetric 95.45 % coverage interval: mean of the intervals of the blocks.
    pub symmetric_interval: Vec<[f64; 2]>,
    /// Shortest 95.45 % coverage interval: mean of the intervals of the blocks.
    pub shortest_interval: Vec<[f64; 2]>,
}

/// Contains the number of trials.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0} trials are too few to compute a scatter; set at least 2, better 10 000")]
pub struct TooFewTrials(pub usize);

impl TrialStatistics {
    /// Whether the trials contradict the standard uncertainty `u` of an output by first-order propagation (JCGM 101,
    /// 8.1.3). The difference must exceed both the numerical tolerance of `u` with two digits and four times the
    /// trials' own scatter, u/√(2·trials).
    pub fn contradicts_uncertainty(&self, output: usize, u: f64) -> bool {
        let off = (u - self.standard_deviation[output]).abs();
        off > numerical_tolerance(u, 2) && off > 4.0 / (2.0 * self.trial_count as f64).sqrt() * u
    }
}

/// Propagates distributions by Monte Carlo trials: a fixed number, or block by block until the results are stable
/// (JCGM 101, 7.9). `compute` receives a stream and a number of trials, draws the inputs and returns the outputs,
/// trials × `output_count`. The same `seed` gives identical results for any number of threads.
///
/// # Errors
/// Fewer than two trials.
pub fn propagate_distributions(
    trials: TrialCount,
    seed: u64,
    output_count: usize,
    compute: impl Fn(&mut DrawStream, usize) -> Mat<f64> + Sync,
) -> Result<TrialStatistics, TooFewTrials> {
    let (total, digits) = match trials {
        TrialCount::Fixed(total) => (total, None),
        TrialCount::Adaptive { digits, max } => (max, Some(digits)),
    };
    if total < 2 {
        return Err(TooFewTrials(total));
    }
    let sizes = block_sizes(total);
    let mut joined = MergedTrialBlocks::new(output_count);
    for (wave, sizes) in sizes.chunks(BLOCKS_PER_STABILITY_CHECK).enumerate() {
        let numbered = sizes.par_iter().enumerate();
        let blocks: Vec<TrialBlockStatistics> = numbered
            .map(|(i, size)| {
                compute_block(seed, (wave * BLOCKS_PER_STABILITY_CHECK + i) as u64, *size, output_count, &compute)
            })
            .collect();
        blocks.into_iter().for_each(|block| joined.push(block));
        if digits.is_some_and(|digits| joined.is_stable(digits)) {
            return Ok(joined.into_statistics(true));
        }
    }
    Ok(joined.into_statistics(digits.is_none()))
}

/// Sizes of nearly equal blocks of at least 10⁴ trials. A block is smaller only if `total` is smaller.
fn block_sizes(total: usize) -> Vec<usize> {
    let blocks = (total / MIN_TRIALS_PER_BLOCK).max(1);
    (0..blocks).map(|b| total / blocks + usize::from(b < total % blocks)).collect()
}

/// Computes the trials of one block, in parallel; the random stream depends on `seed`, `block_number` and the number
/// of the chunk in the block.
fn compute_block(
    seed: u64,
    block_number: u64,
    trial_count: usize,
    output_count: usize,
    compute: &(impl Fn(&mut DrawStream, usize) -> Mat<f64> + Sync),
) -> TrialBlockStatistics {
    let chunk = |chunk: usize| -> Vec<Mat<f64>> {
        let count = TRIALS_PER_RANDOM_STREAM.min(trial_count - chunk * TRIALS_PER_RANDOM_STREAM);
        let mut random = DrawStream::from_key(seed, &[block_number, chunk as u64]);
        let starts = (0..count).step_by(TRIALS_PER_CALL);
        starts.map(|first| compute(&mut random, TRIALS_PER_CALL.min(count - first))).collect()
    };
    let chunks: Vec<_> = (0..trial_count.div_ceil(TRIALS_PER_RANDOM_STREAM)).into_par_iter().map(chunk).collect();
    let mut values = Mat::zeros(trial_count, output_count);
    let mut first = 0;
    for part in chunks.into_iter().flatten() {
        values.subrows_mut(first, part.nrows()).copy_from(&part);
        first += part.nrows();
    }
    TrialBlockStatistics::new(values)
}

/// δ of JCGM 101, 7.9.2: half a unit in the last of the `digits` significant digits of `u`; 0 if `u` is not positive
/// and finite.
pub fn numerical_tolerance(u: f64, digits: u32) -> f64 {
    if u > 0.0 && u.is_finite() { 0.5 * 10_f64.powi(u.log10().floor() as i32 + 1 - digits as i32) } else { 0.0 }
}

#[cfg(test)]
mod tests;
