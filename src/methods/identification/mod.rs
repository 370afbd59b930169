//! The identification core that all methods share: from a solved observation model and its sources of
//! uncertainty to the estimate.
//!
//! A method solves its equations and gives an [`ObservationModel`] at the solution, a list of
//! [`UncertaintySource`]s and its [`Outputs`]. [`identify`] propagates the sources to first order (JCGM 100)
//! and by Monte Carlo trials (JCGM 101). [`Identification::estimate`] makes the estimate. Observations are
//! numbers of one unit, mm, in an order that the method fixes; sources refer to them by index. The core
//! imports no method.

mod aliasing;
pub mod azimuth;
mod blocks;
mod budget_keys;
pub mod declared;
mod error_motions;
mod estimate;
mod forecast;
mod harmonics;
mod known_errors;
mod known_motions;
mod likely_sources;
mod measurement;
mod model;
mod outliers;
mod outputs;
mod periodic_points;
pub mod probe_map;
mod propagation;
mod range;
mod source;
mod trials;
mod warnings;

pub use aliasing::{LOCATION_ERRORS_TEXT, describe_aliased_orders, describe_plan_aliasing};
pub use blocks::{BlockEquations, BlockFit, BlockwiseFit};
pub use budget_keys::add_budget_sensitivities;
pub use error_motions::{RevolutionRanges, revolution_parameters, synchronous_ranges};
pub use estimate::{Identification, identify, parameter_with_budget, parameter_without_budget};
pub use forecast::{describe_assumed_repeatability, describe_expected_uncertainty, with_assumed_repeatability};
pub use harmonics::{Harmonic, HarmonicFunction, function_over_numbers, function_over_orders};
pub use known_errors::KnownErrors;
pub use known_motions::KnownMotions;
pub use measurement::{CheckedMeasurement, mean_coordinate_u_mm};
pub use model::{
    FitQuality, LeastSquares, LinearFit, ObservationEquation, ObservationModel, Response, SolvedModel, multiply_vector,
    rms, solve_each_trial,
};
pub use outliers::OutlierCheck;
pub use outputs::{
    NonlinearOutputs, OutputCurve, OutputParameter, Outputs, central_differences, dot_product, reported_unit,
    unit_slope,
};
pub use propagation::{Propagation, Uncertainty};
pub use range::{RangeOutput, range_outputs};
pub use source::{
    DrawDistribution, EvaluationType, ObservationEffect, ObservationSpan, ResidualTreatment, UncertaintySource,
    block_covariances, linear_combination, prior_covariance,
};
pub use trials::{TrialPlan, propagate_by_trials};
pub use warnings::MisfitAdvice;

#[cfg(test)]
mod tests;
