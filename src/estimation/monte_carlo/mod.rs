//! Monte Carlo propagation of distributions (JCGM 101). Seeded: each chunk of trials draws from a
//! ChaCha8 stream of its own and results are joined in order, so that the number of threads does
//! not change a bit of the answer.

mod block;
mod blocks;
mod linear;
mod normal;
mod random;
mod shape;

use faer::Mat;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::random::stream;
use block::{Block, Joined};

pub use blocks::propagate_blocks;
pub use linear::{BLOCK, LinearPropagation, Moments};
pub use normal::NormalLanes;
pub use random::Random;
pub use shape::Shape;

/// Trials of a block; its intervals are read from its own sorted values (JCGM 101, 7.9.4: at least
/// 10⁴ for 95 %).
const BLOCK_TRIALS: usize = 10_000;
/// Trials that share a random stream.
const CHUNK_TRIALS: usize = 1_000;
/// Blocks between two looks at the stopping rule.
const WAVE: usize = 4;

/// How many trials.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trials {
    Fixed(usize),
    /// Blocks of 10⁴ until means, standard deviations and interval ends of all outputs are stable
    /// to `digits` significant digits of the standard deviation (JCGM 101, 7.9), or `max` trials.
    Adaptive {
        digits: u32,
        max: usize,
    },
}

impl Trials {
    /// As many as a person asked for; 0 leaves it to the adaptive rule.
    pub fn asked(count: usize, digits: u32, max: usize) -> Self {
        if count == 0 { Self::Adaptive { digits, max } } else { Self::Fixed(count) }
    }
}

/// What the trials show, one entry per output.
#[derive(Debug, Clone)]
pub struct Summary {
    pub trials: usize,
    /// Whether the adaptive rule was met; `true` for a fixed number.
    pub stable: bool,
    pub mean: Vec<f64>,
    pub standard_deviation: Vec<f64>,
    pub covariance: Mat<f64>,
    /// Probabilistically symmetric 95.45 % coverage interval: mean of the blocks' intervals.
    pub interval: Vec<[f64; 2]>,
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MonteCarloError<E: std::error::Error> {
    #[error("{0} trials show no scatter; ask for at least 2, better 10 000")]
    TooFew(usize),
    #[error("a trial of block {block} failed: {source}")]
    Trial { block: usize, source: E },
}

impl Summary {
    /// Whether the trials contradict the standard uncertainty `u` of an output by first-order
    /// propagation (JCGM 101, 8.1.3): by more than the numerical tolerance of a u stated with two
    /// digits, and by more than the trials' own scatter.
    pub fn contradicts(&self, output: usize, u: f64) -> bool {
        let off = (u - self.standard_deviation[output]).abs();
        off > numerical_tolerance(u, 2) && off > 4.0 / (2.0 * self.trials as f64).sqrt() * u
    }
}

/// Runs `trial` again and again; it draws its inputs from the stream it is given and writes its
/// outputs. [`propagate_blocks`] computes many trials at once.
///
/// # Errors
/// The first error of a trial, in the order of the trials.
pub fn propagate<E: std::error::Error + Send>(
    trials: Trials,
    seed: u64,
    outputs: usize,
    trial: impl Fn(&mut ChaCha8Rng, &mut [f64]) -> Result<(), E> + Sync,
) -> Result<Summary, MonteCarloError<E>> {
    let (total, digits) = match trials {
        Trials::Fixed(total) => (total, None),
        Trials::Adaptive { digits, max } => (max, Some(digits)),
    };
    if total < 2 {
        return Err(MonteCarloError::TooFew(total));
    }
    let sizes = block_sizes(total);
    let mut joined = Joined::new(outputs);
    for (wave, sizes) in sizes.chunks(WAVE).enumerate() {
        let first = wave * WAVE;
        for block in run_wave(sizes, first, seed, outputs, &trial)? {
            joined.push(block);
        }
        if digits.is_some_and(|digits| joined.is_stable(digits)) {
            return Ok(joined.summary(true));
        }
    }
    Ok(joined.summary(digits.is_none()))
}

/// Nearly equal blocks of at least 10⁴ (fewer only when there are fewer in all).
fn block_sizes(total: usize) -> Vec<usize> {
    let blocks = (total / BLOCK_TRIALS).max(1);
    (0..blocks).map(|b| total / blocks + usize::from(b < total % blocks)).collect()
}

fn run_wave<E: std::error::Error + Send>(
    sizes: &[usize],
    first: usize,
    seed: u64,
    outputs: usize,
    trial: &(impl Fn(&mut ChaCha8Rng, &mut [f64]) -> Result<(), E> + Sync),
) -> Result<Vec<Block>, MonteCarloError<E>> {
    let values: Vec<Result<Vec<f64>, MonteCarloError<E>>> = sizes
        .par_iter()
        .enumerate()
        .map(|(index, size)| {
            let block = first + index;
            let chunks: Vec<Result<Vec<f64>, E>> = (0..size.div_ceil(CHUNK_TRIALS))
                .into_par_iter()
                .map(|chunk| {
                    let count = CHUNK_TRIALS.min(size - chunk * CHUNK_TRIALS);
                    let mut rng = stream(seed, &[block as u64, chunk as u64]);
                    let mut values = vec![0.0; count * outputs];
                    for row in 0..count {
                        trial(&mut rng, &mut values[row * outputs..][..outputs])?;
                    }
                    Ok(values)
                })
                .collect();
            let joined: Result<Vec<Vec<f64>>, E> = chunks.into_iter().collect();
            joined
                .map(|chunks| chunks.concat())
                .map_err(|source| MonteCarloError::Trial { block, source })
        })
        .collect();
    let values: Vec<Vec<f64>> = values.into_iter().collect::<Result<_, _>>()?;
    let blocks = values.par_iter().zip(sizes);
    let block = |(values, size): (&Vec<f64>, &usize)| {
        Block::new(Mat::from_fn(*size, outputs, |i, j| values[i * outputs + j]))
    };
    Ok(blocks.map(block).collect())
}

/// δ of JCGM 101, 7.9.2: half a unit in the last of the `digits` significant digits of `u`.
pub fn numerical_tolerance(u: f64, digits: u32) -> f64 {
    if u > 0.0 && u.is_finite() {
        0.5 * 10_f64.powi(u.log10().floor() as i32 + 1 - digits as i32)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests;
