//! Identification: from plan and readings to the estimate.

use super::fit::{GeometryEquations, GeometryProblem};
use super::geometry_solution::{GeometrySolution, solve_geometry};
use super::outputs;
use super::settings::SambaSettings;
use crate::IdentifyError;
use crate::identification::{self, FitQuality, NonlinearFit, SolvedModel, TrialSettings, UncertaintySource};
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Seed of the Monte Carlo propagation: fixed, so that the same readings give the same bytes.
const MONTE_CARLO_SEED: u64 = 0x7361_6d62;
/// Maximum number of operations of the adaptive Monte Carlo propagation, so that it takes seconds.
const MAX_PROPAGATION_OPERATIONS: usize = 8_000_000_000;
/// Number of trials that are allowed for any number of operations, for the first check of stability.
const ALWAYS_ALLOWED_TRIALS: usize = 40_000;
/// Significant digits of u to which the trials must be stable. JCGM 101, 7.9.2 uses one or two; two digits of
/// so many unknowns at once would need about a million trials.
const STABLE_U_DIGITS: u32 = 1;

/// The whole identification of a plan's readings. In the trials a centre is a linear function of its touches.
/// A sphere fit is so nearly linear that touches drawn and fitted one by one give the same u to two digits,
/// even with ten times the scatter of a probe
/// (`touches_drawn_one_by_one_scatter_as_drawn_centres_do`).
pub fn identify(plan: &Plan, settings: &SambaSettings, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
    let solved = solve_geometry(plan, settings, readings)?;
    let GeometrySolution { problem, sources, measured, minimum, rank_analysis: survey, .. } = &solved;
    let solution = SolvedModel {
        model: &NonlinearFit { equation: &GeometryEquations { problem, measured }, minimum },
        weighted_residuals: &minimum.residuals,
        has_declared_source_sizes: plan.probe.repeatability_um.is_some(),
        fit_quality: FitQuality::from_nonlinear_fit(survey, minimum, &solved.position_residuals()),
        measurements: &solved.checked_measurements(),
    };
    let trials = trial_settings(settings, problem, sources);
    let outputs = outputs::build_outputs(&solved);
    let identified = identification::identify(&solution, sources, outputs, Some(trials))?;
    Ok(outputs::build_estimate(&solved, &identified))
}

fn trial_settings(settings: &SambaSettings, problem: &GeometryProblem, sources: &[UncertaintySource]) -> TrialSettings {
    let draws = sources.iter().flat_map(|s| (0..s.draw_count()).map(|draw| s.draw_span(draw).1.len()));
    let operations = draws.sum::<usize>() + 100 * problem.row_count() + 1;
    let max = (MAX_PROPAGATION_OPERATIONS / operations).clamp(ALWAYS_ALLOWED_TRIALS, 200_000);
    TrialSettings::new(MONTE_CARLO_SEED, settings.monte_carlo_trials, STABLE_U_DIGITS, max)
}
