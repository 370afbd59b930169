//! Distributions of the independent draws of an uncertainty source.

/// Distribution of one independent draw of unit variance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DrawDistribution {
    Normal,
    Rectangular,
}
