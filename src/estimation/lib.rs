//! Estimation: least squares with a report of rank, condition and covariance, circle and sphere fits, trigonometric
//! interpolation, coverage factors, Monte Carlo, seeded random streams. This package does not depend on any machine
//! model.

#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used, clippy::panic))]

pub mod circle;
pub mod coverage;
mod gram_schmidt;
pub mod independence;
pub mod linear_least_squares;
pub mod misfit;
pub mod monte_carlo;
pub mod nonlinear_least_squares;
pub mod null_space_names;
mod radial_fit;
pub mod random;
pub mod revolutions;
pub mod rigid_fit;
pub mod schur;
pub mod smooth_functions;
pub mod sphere;
pub mod thin_svd;
pub mod trigonometric_interpolation;
pub mod whitening;

#[cfg(test)]
mod tests;
