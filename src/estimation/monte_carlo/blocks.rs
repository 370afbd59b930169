//! Trials computed many at a time: observations, unknowns and outputs are columns over trials.

use std::convert::Infallible;

use faer::Mat;
use rayon::prelude::*;

use super::block::{Block, Joined};
use super::{CHUNK_TRIALS, MonteCarloError, Random, Summary, Trials, WAVE, block_sizes};

/// Trials of one call of `compute`; divides [`CHUNK_TRIALS`].
const TRIALS_PER_CALL: usize = 200;

/// Monte Carlo propagation (JCGM 101) by trials in blocks. `compute` draws the inputs of so many trials
/// from the stream that it is given and returns the outputs, trials × `outputs`. The same `seed` gives
/// the same bytes, whatever the number of threads.
///
/// # Errors
/// Fewer than two trials.
pub fn propagate_blocks(
    trials: Trials,
    seed: u64,
    outputs: usize,
    compute: impl Fn(&mut Random, usize) -> Mat<f64> + Sync,
) -> Result<Summary, MonteCarloError<Infallible>> {
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
        let numbered = sizes.par_iter().enumerate();
        let blocks: Vec<Block> = numbered
            .map(|(i, size)| one_block(seed, (wave * WAVE + i) as u64, *size, outputs, &compute))
            .collect();
        blocks.into_iter().for_each(|block| joined.push(block));
        if digits.is_some_and(|digits| joined.is_stable(digits)) {
            return Ok(joined.summary(true));
        }
    }
    Ok(joined.summary(digits.is_none()))
}

fn one_block(
    seed: u64,
    number: u64,
    size: usize,
    outputs: usize,
    compute: &(impl Fn(&mut Random, usize) -> Mat<f64> + Sync),
) -> Block {
    let chunk = |chunk: usize| -> Vec<Mat<f64>> {
        let count = CHUNK_TRIALS.min(size - chunk * CHUNK_TRIALS);
        let mut random = Random::of(seed, &[number, chunk as u64]);
        let starts = (0..count).step_by(TRIALS_PER_CALL);
        starts.map(|first| compute(&mut random, TRIALS_PER_CALL.min(count - first))).collect()
    };
    let chunks: Vec<_> = (0..size.div_ceil(CHUNK_TRIALS)).into_par_iter().map(chunk).collect();
    let mut values = Mat::zeros(size, outputs);
    let mut first = 0;
    for part in chunks.into_iter().flatten() {
        values.subrows_mut(first, part.nrows()).copy_from(&part);
        first += part.nrows();
    }
    Block::new(values)
}
