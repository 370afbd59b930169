//! Draws of many trials at once.

use rand_chacha::ChaCha8Rng;

use super::Shape;
use crate::random::stream;

/// A stream of independent draws of mean 0 and variance 1.
#[derive(Debug, Clone)]
pub struct Random(ChaCha8Rng);

impl Random {
    /// The [`stream`] of `seed` for `key`.
    pub fn of(seed: u64, key: &[u64]) -> Self {
        Self(stream(seed, key))
    }

    /// Trials × draws, column after column; draw `j` has the distribution `shapes[j]`. The stream is
    /// read trial after trial, so that a trial does not depend on how many are drawn at once.
    pub fn units(&mut self, trials: usize, shapes: &[Shape]) -> Vec<f64> {
        let mut units = vec![0.0; trials * shapes.len()];
        for trial in 0..trials {
            for (j, shape) in shapes.iter().enumerate() {
                units[j * trials + trial] = shape.draw(&mut self.0);
            }
        }
        units
    }
}
