//! How one independent draw of a source is distributed.

use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

/// Distribution of one independent draw of unit variance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    Normal,
    Rectangular,
}

impl Shape {
    pub fn draw(self, rng: &mut impl Rng) -> f64 {
        match self {
            Self::Normal => StandardNormal.sample(rng),
            Self::Rectangular => (rng.random::<f64>() - 0.5) * 12f64.sqrt(),
        }
    }
}
