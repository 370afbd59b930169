//! Plan + readings → estimate.

use nalgebra::Vector3;

use super::design::Design;
use super::equations::solve;
use super::layout::COMPONENTS;
use super::observe::{Measured, measured};
use super::outputs;
use super::plate::Plate;
use super::settings::Settings;
use super::solved::Solved;
use super::warnings;
use crate::IdentifyError;
use crate::ball_measurement::{nonzero_columns, shifts, touch_sources};
use crate::identification::declared::drift_mm_per_s;
use crate::identification::{
    self, FitFigures, LinearFit, Solution, TrialPlan, UncertaintySource, block_covariances,
    numbered_values, rms,
};
use estimation::linear::Survey;
use estimation::monte_carlo::Trials;
use estimation::null_names::name_null_space;
use machine::Axis;
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Seed of the Monte Carlo propagation: fixed, so that the same readings give the same bytes.
const MONTE_CARLO_SEED: u64 = 0x6261_6c6c;
/// Significant digits of u in which the trials shall be stable (JCGM 101, 7.9.2).
const STABLE_DIGITS: u32 = 1;
/// Products of the Monte Carlo propagation at most, so that it stays a matter of seconds.
const MAX_PRODUCTS: usize = 8_000_000_000;
/// No coordinate has more weight than one of this standard uncertainty, mm.
const MIN_U_MM: f64 = 1e-6;
/// Assumed time constant of a machine that settles, s: what the declared drift rate changes by within a run.
const SETTLING_S: f64 = 7200.0;
/// Lost combinations that are named at most.
const MAX_NAMED_LOST: usize = 4;

/// # Errors
/// Readings that do not belong to the plan or do not separate the unknowns.
pub fn identify(
    plan: &Plan,
    settings: &Settings,
    readings: &[Reading],
) -> Result<Estimate, IdentifyError> {
    let plate = Plate::new(plan, settings)?;
    let mut design = Design::new(plan, settings, &plate)?;
    let measured = measured(plan, settings, &plate, &design, readings)?;
    let interruptions = measured.sightings.iter().map(|sighting| sighting.segment).max();
    design.layout.interruptions = interruptions.filter(|_| !settings.values).unwrap_or(0);
    let sources = sources(plan, &measured);
    let sigma = sigma(&sources, measured.sightings.len());
    let names = design.layout.names(plate.axis);
    let lost = |survey: &Survey| {
        let mut named = name_null_space(survey.null_space.as_ref(), &names);
        named.truncate(MAX_NAMED_LOST);
        named
    };
    let (a, solution) = solve(&design.layout, &design.stops, &measured.sightings, &sigma)
        .map_err(|error| IdentifyError::unsolved(error, lost))?;
    let (plate, design) = (&plate, &design);
    let solved = Solved { plan, settings, plate, design, measured, sigma, a, solution };
    estimate(&solved, &sources)
}

fn estimate(solved: &Solved<'_>, sources: &[UncertaintySource]) -> Result<Estimate, IdentifyError> {
    let Solved { plan, settings, design, sigma, a, solution, .. } = solved;
    let model = LinearFit { x: &solution.x, a, sigma, gain: &solution.gain };
    let weighted: Vec<f64> = solution.residuals.iter().zip(sigma).map(|(r, s)| r / s).collect();
    let gauge = design.layout.gauge(&design.stops).nrows();
    let unknowns = design.layout.unknowns() - gauge;
    let core = Solution {
        model: &model,
        residuals: &weighted,
        is_declared: plan.probe.repeatability_um.is_some(),
        figures: FitFigures { unknowns, ..FitFigures::of_linear(solution) },
    };
    let products = (a.nrows() * a.ncols()).max(1);
    let max = (MAX_PRODUCTS / products).clamp(2_000, 200_000);
    let trials = Trials::asked(settings.monte_carlo_trials, STABLE_DIGITS, max);
    let trials = TrialPlan { seed: MONTE_CARLO_SEED, trials };
    let outputs = outputs::outputs(solved);
    let identified = identification::identify(&core, sources, outputs, Some(trials))?;
    let mut estimate = Estimate {
        gauge: warnings::gauge(solved),
        not_identifiable: warnings::not_identifiable(solved),
        warnings: warnings::warnings(solved, &identified),
        ..identified.estimate(super::NAME)
    };
    // The ranges, which tolerances are stated for, come first.
    estimate.parameters.rotate_right(COMPONENTS.len());
    let spectra = outputs::harmonic_functions(solved);
    let spectra = spectra.iter().map(|motion| identified.spectrum(motion, &solution.x));
    estimate.functions.splice(COMPONENTS.len()..COMPONENTS.len(), spectra);
    let of_visit = solution.residuals.chunks(3).map(rms);
    estimate.functions.push(numbered_values("residual_rms", "visit", of_visit));
    Ok(estimate)
}

/// Errors of X, Y and Z that stay as they are belong to the measuring positions, and no source.
fn sources(plan: &Plan, measured: &Measured) -> Vec<UncertaintySource> {
    let centres = &measured.observed.centres;
    let mut list = touch_sources(plan, &measured.observed);
    let first_s = centres.first().map_or(0.0, |centre| centre.t_s);
    // The fitted polynomial takes a constant rate whole; this is how a rate may change.
    let settled = |t_s: f64| SETTLING_S * (1.0 - (-(t_s - first_s) / SETTLING_S).exp());
    let rate = drift_mm_per_s(plan);
    let column = |axis: Axis| {
        shifts(centres, |centre| -> Vector3<f64> {
            axis.direction() * (rate * settled(centre.t_s))
        })
    };
    list.push(UncertaintySource {
        is_in_weights: false,
        ..UncertaintySource::new(
            "change of the drift rate",
            nonzero_columns(Axis::LINEAR.map(column)),
        )
    });
    list.iter_mut().filter(|source| source.name == "thermal drift").for_each(|source| {
        source.is_in_weights = false;
    });
    list.retain(|source| source.draws() > 0);
    list
}

fn sigma(sources: &[UncertaintySource], sightings: usize) -> Vec<f64> {
    let blocks = block_covariances::<3>(sources, sightings);
    let of_block = |block: &nalgebra::Matrix3<f64>| {
        [0, 1, 2].map(|axis| block[(axis, axis)].sqrt().max(MIN_U_MM))
    };
    blocks.iter().flat_map(of_block).collect()
}
