//! The identification core that all methods share: from a solved observation model and its sources of
//! uncertainty to the estimate.
//!
//! A method solves its equations and gives an [`ObservationModel`] at the solution, a list of
//! [`UncertaintySource`]s and its [`IdentificationOutputs`]. [`identify`] propagates the sources to first order
//! (JCGM 100) and by Monte Carlo trials (JCGM 101). [`Identification::estimate`] makes the estimate. Observations are
//! numbers of one unit, mm, in an order that the method fixes; sources refer to them by index. The core
//! imports no method.

mod aliasing;
pub mod azimuth_dependence;
mod blockwise_fit;
mod budget_keys;
mod checked_measurement;
pub mod declared_sources;
mod error_motions;
mod estimate;
mod forecast;
mod harmonics;
mod known_errors;
mod known_motions;
mod misfit_causes;
mod monte_carlo_trials;
mod observation_model;
mod outliers;
mod output_range;
mod outputs;
mod periodic_points;
pub mod probe_map;
mod propagation;
mod spindle_position;
mod uncertainty_source;
mod warnings;

pub use aliasing::{LOCATION_ERRORS_TEXT, describe_aliased_orders, describe_plan_aliasing};
pub use blockwise_fit::{BlockEquations, BlockFit, BlockwiseFit};
pub use budget_keys::add_budget_sensitivities;
pub use checked_measurement::{MeasurementToCheck, mean_coordinate_u_mm};
pub use error_motions::{ErrorMotionValues, synchronous_ranges, total_and_asynchronous_parameters};
pub use estimate::{Identification, identify, parameter_with_budget, parameter_without_budget};
pub use forecast::{describe_assumed_repeatability, describe_expected_uncertainty, plan_with_assumed_repeatability};
pub use harmonics::{Harmonic, HarmonicFunction, function_of_numbered_values, function_over_harmonic_orders};
pub use known_errors::KnownErrors;
pub use known_motions::KnownErrorMotions;
pub use monte_carlo_trials::{TrialSettings, propagate_by_trials};
pub use observation_model::{
    FitQuality, LinearResponse, NonlinearFit, ObservationEquation, ObservationModel, SolvedLinearFit, SolvedModel,
    multiply_vector, rms, solve_each_trial,
};
pub use outliers::OutlierCheck;
pub use output_range::{RangeOutput, range_outputs};
pub use outputs::{
    IdentificationOutputs, NonlinearOutputs, OutputCurve, OutputParameter, central_differences, dot_product,
    reported_unit, slope_of_unknown,
};
pub use propagation::{Propagation, Uncertainty};
pub use spindle_position::{SpindlePosition, StatedStylusUncertainty, UndeterminedSpindleComponent};
pub use uncertainty_source::{
    DrawDistribution, EvaluationType, ObservationEffect, ObservationSpanChange, ResidualTreatment, UncertaintySource,
    block_covariances, linear_combination, prior_covariance,
};
pub use warnings::MisfitAdvice;

#[cfg(test)]
mod tests;
