//! Identification: from plan and readings to the estimate.

use super::fit::{Measurement, Problem};
use super::outputs;
use super::settings::Settings;
use super::solution::{GeometrySolution, solve_geometry};
use crate::IdentifyError;
use crate::identification::{
    self, FitFigures, LeastSquares, Solution, TrialPlan, UncertaintySource,
};
use estimation::monte_carlo::Trials;
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Seed of the Monte Carlo propagation: fixed, so that the same readings give the same bytes.
const MONTE_CARLO_SEED: u64 = 0x7361_6d62;
/// Maximum number of operations of the adaptive Monte Carlo propagation, so that it takes seconds.
/// `LEAST_TRIALS` is always allowed, for the first check of stability.
const MOST_WORK: usize = 8_000_000_000;
const LEAST_TRIALS: usize = 40_000;
/// Significant digits of u to which the trials must be stable. JCGM 101, 7.9.2 uses one or two; two digits of
/// so many unknowns at once would need about a million trials.
const STABLE_DIGITS: u32 = 1;

/// The whole identification of a plan's readings. In the trials a centre is a linear function of its touches.
/// A sphere fit is so nearly linear that touches drawn and fitted one by one give the same u to two digits,
/// even with ten times the scatter of a probe
/// (`regress_touches_drawn_one_by_one_scatter_as_drawn_centres_do`).
pub fn identify(
    plan: &Plan,
    settings: &Settings,
    readings: &[Reading],
) -> Result<Estimate, IdentifyError> {
    let solved = solve_geometry(plan, settings, readings)?;
    let GeometrySolution { problem, sources, measured, minimum, survey, .. } = &solved;
    let solution = Solution {
        model: &LeastSquares { equation: &Measurement { problem, measured }, minimum },
        residuals: &minimum.residuals,
        is_declared: plan.probe.repeatability_um.is_some(),
        figures: FitFigures::of_places(survey, minimum, &solved.misses()),
        measurements: &solved.measurements(),
    };
    let trials = trial_plan(settings, problem, sources);
    let outputs = outputs::outputs(&solved);
    let identified = identification::identify(&solution, sources, outputs, Some(trials))?;
    Ok(outputs::estimate(&solved, &identified))
}

fn trial_plan(settings: &Settings, problem: &Problem, sources: &[UncertaintySource]) -> TrialPlan {
    let draws = sources.iter().flat_map(|s| (0..s.draws()).map(|draw| s.run(draw).1.len()));
    let work = draws.sum::<usize>() + 100 * problem.rows_count() + 1;
    let max = (MOST_WORK / work).clamp(LEAST_TRIALS, 200_000);
    let trials = Trials::asked(settings.monte_carlo_trials, STABLE_DIGITS, max);
    TrialPlan { seed: MONTE_CARLO_SEED, trials }
}
