//! Identification: from plan and readings to the estimate.

use super::cross_check::CrossCheck;
use super::layout::COMPONENTS;
use super::plate::Plate;
use super::settings::Settings;
use super::solved::Solved;
use super::{cycles, outputs, warnings};
use crate::IdentifyError;
use crate::identification::{
    self, FitFigures, Identification, LinearFit, Solution, TrialPlan, numbered_values, rms,
};
use estimation::monte_carlo::Trials;
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Seed of the Monte Carlo propagation: fixed, so that the same readings give the same bytes.
const MONTE_CARLO_SEED: u64 = 0x6261_6c6c;
/// Significant digits of u to which the trials must be stable (JCGM 101, 7.9.2).
const STABLE_DIGITS: u32 = 1;
/// Maximum number of products in the Monte Carlo propagation, so that it takes seconds.
const MAX_PRODUCTS: usize = 8_000_000_000;

/// # Errors
/// The readings do not belong to the plan or do not separate the unknowns.
pub fn identify(
    plan: &Plan,
    settings: &Settings,
    readings: &[Reading],
) -> Result<Estimate, IdentifyError> {
    let plate = Plate::new(plan, settings)?;
    let solved = Solved::new(plan, settings, &plate, readings)?;
    let products = (solved.a.nrows() * solved.a.ncols()).max(1);
    let max = (MAX_PRODUCTS / products).clamp(2_000, 200_000);
    let trials = Trials::asked(settings.monte_carlo_trials, STABLE_DIGITS, max);
    let trials = TrialPlan { seed: MONTE_CARLO_SEED, trials };
    let identified = identified(&solved, Some(trials))?;
    Ok(estimate(&solved, &identified))
}

/// # Errors
/// Fewer than two trials.
pub fn identified(
    solved: &Solved<'_>,
    trials: Option<TrialPlan>,
) -> Result<Identification, IdentifyError> {
    let Solved { design, sources, sigma, a, solution, .. } = solved;
    let model = LinearFit { x: &solution.x, a, sigma, gain: &solution.gain };
    let weighted: Vec<f64> = solution.residuals.iter().zip(sigma).map(|(r, s)| r / s).collect();
    let gauge = design.layout.gauge(&design.stops).nrows();
    let unknowns = design.layout.unknowns() - gauge;
    let core = Solution {
        model: &model,
        residuals: &weighted,
        is_declared: solved.is_declared,
        figures: FitFigures { unknowns, ..FitFigures::of_linear(solution) },
        measurements: &solved.measurements(),
    };
    identification::identify(&core, sources, outputs::outputs(solved), trials)
}

fn estimate(solved: &Solved<'_>, identified: &Identification) -> Estimate {
    let cross_check = CrossCheck::new(solved, identified);
    let mut gauge = warnings::gauge(solved);
    gauge.push(cross_check.to_string());
    let mut warnings = warnings::warnings(solved, identified);
    warnings.extend(cross_check.warning());
    let mut estimate = Estimate {
        gauge,
        not_identifiable: warnings::not_identifiable(solved, identified),
        warnings,
        ..identified.estimate(super::NAME)
    };
    // The ranges come first, because tolerances are stated for them.
    estimate.parameters.rotate_right(COMPONENTS.len());
    let spectra = outputs::harmonic_functions(solved);
    let spectra = spectra.iter().map(|motion| identified.spectrum(motion, &solved.solution.x));
    estimate.functions.splice(COMPONENTS.len()..COMPONENTS.len(), spectra);
    estimate.functions.extend(cycles::functions(solved));
    let of_visit = solved.solution.residuals.chunks(3).map(rms);
    estimate.functions.push(numbered_values("residual_rms", "visit", of_visit));
    estimate
}
