//! Estimation: least squares with a report of rank, condition and covariance, circle and sphere fits, trigonometric
//! interpolation, coverage factors, Monte Carlo, seeded random streams. This package does not depend on any machine
//! model.

#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod circle;
pub mod coverage;
mod gram_schmidt;
pub mod independence;
pub mod linear;
pub mod misfit;
pub mod monte_carlo;
pub mod nonlinear;
pub mod null_names;
mod radial;
pub mod random;
pub mod revolutions;
pub mod rigid;
pub mod schur;
pub mod smooth;
pub mod sphere;
pub mod thin_svd;
pub mod trigonometric;
pub mod whitening;

#[cfg(test)]
mod tests;
