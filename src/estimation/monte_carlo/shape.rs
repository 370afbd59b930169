//! How one independent draw of a source is distributed.

/// Distribution of one independent draw of unit variance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    Normal,
    Rectangular,
}
