//! Floor 1: estimation. Least squares with rank, condition and covariance report, the circle,
//! trigonometric interpolation, coverage factors, Monte Carlo. Knows nothing of machines.

pub mod linear;

#[cfg(test)]
mod tests;
