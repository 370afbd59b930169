//! The fast path: a linear identification x = gain·y and a small function of x, many trials at
//! once in columns.

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::NormalLanes;
use crate::linear::LinearError;
use crate::random::stream;

/// Trials side by side: the length of a column.
pub const BLOCK: usize = 512;
/// Blocks that share a random stream.
const CHUNK_BLOCKS: usize = 32;
const LANES: usize = 8;

/// Independent normal inputs through a linear identification.
#[derive(Debug, Clone)]
pub struct LinearPropagation<'a> {
    /// Rows × unknowns: the gain, transposed, times the standard uncertainty of each row.
    scaled: Mat<f64>,
    estimate: &'a [f64],
}

/// Mean and standard deviation of one output.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Moments {
    pub trials: usize,
    pub mean: f64,
    squares: f64,
}

impl<'a> LinearPropagation<'a> {
    /// `gain` is unknowns × rows, `sigma` the standard uncertainty of each row; the unknowns
    /// scatter about `estimate`.
    ///
    /// # Errors
    /// When the lengths do not fit together.
    pub fn new(
        gain: MatRef<'_, f64>,
        sigma: &[f64],
        estimate: &'a [f64],
    ) -> Result<Self, LinearError> {
        if sigma.len() != gain.ncols() || estimate.len() != gain.nrows() {
            return Err(LinearError::Malformed("gain, sigmas and estimate differ in length"));
        }
        let scaled = Mat::from_fn(gain.ncols(), gain.nrows(), |i, j| gain[(j, i)] * sigma[i]);
        Ok(Self { scaled, estimate })
    }

    /// `trials` trials: moments of the unknowns, then of `outputs` further values that `function`
    /// computes from them. `function` gets the unknowns and its outputs in columns of [`BLOCK`]
    /// trials: unknown j of trial i is element `j·BLOCK + i`.
    ///
    /// The same seed gives the same bytes for any number of threads.
    pub fn run(
        &self,
        trials: usize,
        seed: u64,
        outputs: usize,
        function: impl Fn(&[f64], &mut [f64]) + Sync,
    ) -> Vec<Moments> {
        let (rows, unknowns) = (self.scaled.nrows(), self.scaled.ncols());
        let chunk_trials = CHUNK_BLOCKS * BLOCK;
        let chunks: Vec<Vec<Moments>> = (0..trials.div_ceil(chunk_trials))
            .into_par_iter()
            .map(|chunk| {
                let count = chunk_trials.min(trials - chunk * chunk_trials);
                let mut normals = NormalLanes::from_stream(&mut stream(seed, &[chunk as u64]));
                let mut columns = Columns::new(rows, unknowns, outputs);
                let mut moments = vec![Moments::default(); unknowns + outputs];
                for start in (0..count).step_by(BLOCK) {
                    columns.draw(&mut normals, self.scaled.as_ref(), self.estimate);
                    let (x, derived) = columns.values.split_at_mut(unknowns * BLOCK);
                    function(x, derived);
                    let used = BLOCK.min(count - start);
                    for (moments, column) in moments.iter_mut().zip(columns.values.chunks(BLOCK)) {
                        *moments = moments.joined(Moments::of(&column[..used]));
                    }
                }
                moments
            })
            .collect();
        chunks.into_iter().fold(vec![Moments::default(); unknowns + outputs], |total, chunk| {
            total.into_iter().zip(chunk).map(|(total, chunk)| total.joined(chunk)).collect()
        })
    }
}

/// Working space of one chunk, all in columns of [`BLOCK`].
struct Columns {
    noise: Vec<f64>,
    /// Unknowns, then outputs of the function.
    values: Vec<f64>,
}

impl Columns {
    fn new(rows: usize, unknowns: usize, outputs: usize) -> Self {
        Self { noise: vec![0.0; rows * BLOCK], values: vec![0.0; (unknowns + outputs) * BLOCK] }
    }

    /// New unknowns: estimate + noise·scaled (scaled: rows × unknowns).
    fn draw(&mut self, normals: &mut NormalLanes, scaled: MatRef<'_, f64>, estimate: &[f64]) {
        let (rows, unknowns) = (scaled.nrows(), scaled.ncols());
        normals.fill(&mut self.noise);
        let x = &mut self.values[..unknowns * BLOCK];
        for (column, estimate) in x.chunks_mut(BLOCK).zip(estimate) {
            column.fill(*estimate);
        }
        let noise = MatRef::from_column_major_slice(&self.noise, BLOCK, rows);
        let x = MatMut::from_column_major_slice_mut(x, BLOCK, unknowns);
        matmul(x, Accum::Add, noise, scaled, 1.0, Par::Seq);
    }
}

impl Moments {
    pub fn standard_deviation(&self) -> f64 {
        (self.squares / (self.trials.max(2) - 1) as f64).sqrt()
    }

    fn of(values: &[f64]) -> Self {
        let arch = Arch::new();
        let mean = arch.dispatch(Sum::<1> { values, about: 0.0 }) / values.len().max(1) as f64;
        let squares = arch.dispatch(Sum::<2> { values, about: mean });
        Self { trials: values.len(), mean, squares }
    }

    /// Chan, Golub, LeVeque 1979.
    fn joined(self, other: Self) -> Self {
        let total = self.trials + other.trials;
        if total == 0 {
            return self;
        }
        let shift = other.mean - self.mean;
        let part = other.trials as f64 / total as f64;
        let between = shift * shift * self.trials as f64 * part;
        Self {
            trials: total,
            mean: self.mean + shift * part,
            squares: self.squares + other.squares + between,
        }
    }
}

/// Σ (value − about)^POWER in a fixed order of eight lanes, so that it can stand in vector registers.
struct Sum<'a, const POWER: i32> {
    values: &'a [f64],
    about: f64,
}

impl<const POWER: i32> WithSimd for Sum<'_, POWER> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        let mut lanes = [0.0; LANES];
        let mut chunks = self.values.chunks_exact(LANES);
        for chunk in &mut chunks {
            for (lane, value) in lanes.iter_mut().zip(chunk) {
                *lane += (value - self.about).powi(POWER);
            }
        }
        let rest = chunks.remainder().iter().map(|value| (value - self.about).powi(POWER));
        lanes.iter().sum::<f64>() + rest.sum::<f64>()
    }
}
