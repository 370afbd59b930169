//! Identification: from plan and readings to the estimate.

use super::cross_check::{LargestCoefficientDifference, describe_cross_check};
use super::plate::Plate;
use super::settings::BallPlateSettings;
use super::solved::SolvedRun;
use super::unknowns_layout::MOTION_COMPONENTS;
use super::{outputs, single_revolutions, warnings};
use crate::IdentifyError;
use crate::identification::{
    self, FitQuality, Identification, SolvedLinearFit, SolvedModel, TrialSettings, function_of_numbered_values, rms,
};
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Seed of the Monte Carlo propagation: fixed, so that the same readings give the same bytes.
const MONTE_CARLO_SEED: u64 = 0x6261_6c6c;
/// Significant digits of u to which the trials must be stable (JCGM 101, 7.9.2).
const STABLE_DIGITS: u32 = 1;
/// Number of multiplications in the Monte Carlo propagation from which the maximum number of adaptive trials follows,
/// so that it takes seconds. This maximum is at least 2000 and at most 200 000.
const MAX_MONTE_CARLO_MULTIPLICATIONS: usize = 8_000_000_000;

/// # Errors
/// The readings do not belong to the plan or do not separate the unknowns.
pub fn identify(plan: &Plan, settings: &BallPlateSettings, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
    let plate = Plate::new(plan, settings)?;
    let solved = SolvedRun::new(plan, settings, &plate, readings)?;
    let products = (solved.design_matrix.nrows() * solved.design_matrix.ncols()).max(1);
    let max = (MAX_MONTE_CARLO_MULTIPLICATIONS / products).clamp(2_000, 200_000);
    let trials = TrialSettings::new(MONTE_CARLO_SEED, settings.monte_carlo_trials, STABLE_DIGITS, max);
    let identified = identify_solved(&solved, Some(trials))?;
    Ok(build_estimate(&solved, &identified))
}

/// Uncertainties, outputs and checks of the solved run. `trials`: `None` for no Monte Carlo propagation.
///
/// # Errors
/// Fewer than two trials.
pub fn identify_solved(solved: &SolvedRun<'_>, trials: Option<TrialSettings>) -> Result<Identification, IdentifyError> {
    let SolvedRun { design, sources, coordinate_sigmas_mm: sigma, design_matrix: a, solution, .. } = solved;
    let model = SolvedLinearFit { x: &solution.x, design_matrix: a, sigma, gain: &solution.gain };
    let weighted: Vec<f64> = solution.residuals.iter().zip(sigma).map(|(r, s)| r / s).collect();
    let gauge = design.layout.gauge_rows(&design.stops).nrows();
    let unknowns = design.layout.unknown_count() - gauge;
    let core = SolvedModel {
        model: &model,
        weighted_residuals: &weighted,
        has_declared_source_sizes: solved.has_declared_source_sizes,
        fit_quality: FitQuality { unknown_count: unknowns, ..FitQuality::from_linear(solution) },
        measurements: &solved.measurements(),
    };
    identification::identify(&core, sources, outputs::build_outputs(solved), trials)
}

fn build_estimate(solved: &SolvedRun<'_>, identified: &Identification) -> Estimate {
    let cross_check = LargestCoefficientDifference::new(solved, identified);
    let mut gauge = warnings::describe_gauge(solved);
    gauge.push(describe_cross_check(&cross_check));
    let mut warnings = warnings::collect_warnings(solved, identified);
    warnings.extend(cross_check.ok().and_then(|difference| difference.warning()));
    let mut estimate = Estimate {
        gauge,
        not_identifiable: warnings::describe_not_identifiable(solved, identified),
        warnings,
        ..identified.estimate(super::METHOD_NAME)
    };
    // The ranges come first, because tolerances are stated for them.
    estimate.parameters.rotate_right(MOTION_COMPONENTS.len());
    let spectra = outputs::harmonic_functions(solved);
    let spectra = spectra.iter().map(|motion| identified.spectrum(motion, &solved.solution.x));
    estimate.functions.splice(MOTION_COMPONENTS.len()..MOTION_COMPONENTS.len(), spectra);
    estimate.functions.extend(single_revolutions::single_revolution_functions(solved));
    let of_visit = solved.solution.residuals.chunks(3).map(rms);
    estimate.functions.push(function_of_numbered_values("residual_rms", "visit", of_visit));
    estimate
}
