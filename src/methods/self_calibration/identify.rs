//! Plan + readings → estimate.

use faer::Mat;

use super::algebra::dot;
use super::assemble;
use super::design::Design;
use super::fit::{Fit, Solved};
use super::model::{Layout, Observation};
use super::observe::observe;
use super::outputs::{self, Output, OutputFunction};
use super::parts::Parts;
use super::plan::Planner;
use super::sense;
use super::settings::Settings;
use super::sources::{UncertaintySource, interruptions, sources, touch_sigma};
use super::uncertainty::{Propagated, TouchScale, disturb};
use crate::{IdentifyError, Refused};
use estimation::linear::LinearError;
use estimation::monte_carlo::{Summary, Trials, propagate};
use estimation::null_names;
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Step};
use machine::record::reading::{Flag, Reading};

/// Seed of the Monte Carlo propagation: fixed, so that the same readings give the same bytes.
const MONTE_CARLO_SEED: u64 = 0x7275_6564;
/// Significant digits of u in which the trials shall be stable (JCGM 101, 7.9.2).
const STABLE_DIGITS: u32 = 2;

/// Bound of the adaptive rule, which usually stops before: 200 000 trials, fewer for large designs,
/// so that it stays a matter of seconds.
fn most_trials(fit: &Fit) -> usize {
    let products = (fit.a.nrows() * fit.a.ncols()).max(1);
    (4_000_000_000 / products).clamp(10_000, 200_000)
}

/// Refuse a cycle whose readings could not be told apart, before the first move: the rank of the
/// nominal design, drift and heights included.
pub fn check_well_posed(
    plan: &Plan,
    settings: &Settings,
    planner: &Planner<'_>,
) -> Result<(), Refused> {
    let mut plan = plan.clone();
    plan.steps = planner.cycle_steps(planner.nominal_part())?;
    let readings: Vec<Reading> = plan.steps.iter().map(nominal_reading).collect();
    let refused = |why: String| Refused {
        why: format!("this cycle cannot tell its unknowns apart: {why}"),
        instead: "lower drift_order, keep references = true, or put the heights further apart"
            .to_owned(),
    };
    let design = Design::new(settings)?;
    let observed = observe(&plan, &design, &planner.heights(), &readings)
        .map_err(|error| refused(error.to_string()))?;
    let layout = Layout {
        design,
        heights: planner.heights().len(),
        drift_order: settings.drift_order,
        gaps: observed.gaps,
    };
    let sigma = vec![1.0; observed.observations.len()];
    fit(&layout, &observed.observations, &sigma, settings)
        .map(drop)
        .map_err(|error| refused(error.to_string()))
}

/// A reading at the start of its touch: only its place in the design counts.
fn nominal_reading(step: &Step) -> Reading {
    Reading {
        step: step.id,
        repeat: 0,
        position: step.from.clone(),
        value_mm: None,
        sensor: step.sensor().to_owned(),
        t_s: f64::from(step.id) + 1.0,
        flag: Flag::None,
        temperatures_c: Default::default(),
    }
}

/// The whole identification of one plan's readings.
pub fn identify(
    plan: &Plan,
    settings: &Settings,
    heights: &[f64],
    readings: &[Reading],
) -> Result<Estimate, IdentifyError> {
    let design = Design::new(settings)?;
    let observed = observe(plan, &design, heights, readings)?;
    let gaps = observed.gaps;
    let layout = Layout { design, heights: heights.len(), drift_order: settings.drift_order, gaps };
    let mut sources =
        sources(plan, &layout, &observed.observations, settings.spindle, observed.half_duration_s);
    let sigma = touch_sigma(&sources, observed.observations.len());
    let fit = fit(&layout, &observed.observations, &sigma, settings)?;
    let radii: Vec<f64> = observed.observations.iter().map(|seen| seen.radius).collect();
    let solved = fit.solve(&radii);
    if !layout.gaps.is_empty() {
        sources.push(interruptions(&layout, &observed.observations, &solved.x));
    }
    let chi2 = chi2(&solved, &sigma);
    let scale = TouchScale::judge(plan.probe.repeatability_um.is_some(), chi2, fit.solution.dof);

    let parameters = outputs::parameters(&layout, heights, mean_radius(&layout, &solved));
    let functions = all_functions(&layout, heights);
    let matrix = output_matrix(&layout, &parameters, &functions);
    let propagated = Propagated::new(&fit.sensitivity(&radii), &matrix, &sources, scale);
    let monte_carlo = propagate_by_trials(&fit, &radii, &parameters, &sources, scale, settings)?;
    let sense = sense::judge(&fit, &sigma, &solved);
    Ok(assemble::estimate(&Parts {
        plan,
        settings,
        heights,
        fit,
        solved,
        chi2,
        scale,
        parameters,
        functions,
        propagated,
        monte_carlo,
        sense,
        timed: observed.timed,
        left_out: observed.left_out,
    }))
}

fn mean_radius(layout: &Layout, solved: &Solved) -> f64 {
    let sum: f64 = (0..layout.heights).map(|height| solved.x[layout.radius(height)]).sum();
    sum / layout.heights as f64
}

fn fit(
    layout: &Layout,
    observations: &[Observation],
    sigma: &[f64],
    settings: &Settings,
) -> Result<Fit, IdentifyError> {
    Fit::new(layout.clone(), observations.to_vec(), sigma, settings.second_order).map_err(|error| {
        match error {
            LinearError::RankDeficient(survey) => IdentifyError::RankDeficient {
                rank: survey.rank,
                unknowns: layout.unknowns(),
                what: a_few(null_names::name_null_space(
                    survey.null_space.as_ref(),
                    &layout.names(),
                )),
            },
            other => IdentifyError::Numerical(other.to_string()),
        }
    })
}

/// The first lines; a person needs no more to see what is wrong.
fn a_few(mut lines: Vec<String>) -> Vec<String> {
    let more = lines.len().saturating_sub(4);
    lines.truncate(4);
    if more > 0 {
        lines.push(format!("and {more} more"));
    }
    lines
}

fn chi2(solved: &Solved, sigma: &[f64]) -> f64 {
    solved.residuals.iter().zip(sigma).map(|(r, s)| (r / s).powi(2)).sum()
}

fn all_functions(layout: &Layout, heights: &[f64]) -> Vec<OutputFunction> {
    (0..layout.heights)
        .flat_map(|h| {
            let suffix =
                if heights.len() > 1 { format!("@Z{:.1}", heights[h]) } else { String::new() };
            outputs::functions(layout, h, &suffix)
        })
        .collect()
}

/// Outputs × unknowns: the parameters first, then the functions' points in order.
fn output_matrix(layout: &Layout, parameters: &[Output], functions: &[OutputFunction]) -> Mat<f64> {
    let rows: Vec<&Vec<f64>> = parameters
        .iter()
        .map(|p| &p.coefficients)
        .chain(functions.iter().flat_map(|f| &f.points))
        .collect();
    Mat::from_fn(rows.len(), layout.unknowns(), |i, j| rows[i][j])
}

/// Monte Carlo through the whole identification, second order included.
fn propagate_by_trials(
    fit: &Fit,
    radii: &[f64],
    parameters: &[Output],
    sources: &[UncertaintySource],
    scale: TouchScale,
    settings: &Settings,
) -> Result<Summary, IdentifyError> {
    let trials = Trials::asked(settings.monte_carlo_trials, STABLE_DIGITS, most_trials(fit));
    propagate(trials, MONTE_CARLO_SEED, parameters.len(), |rng, out| {
        let disturbed = disturb(radii, sources, scale, rng);
        let x = fit.solve(&disturbed).x;
        for (value, parameter) in out.iter_mut().zip(parameters) {
            *value = dot(&parameter.coefficients, &x);
        }
        Ok::<(), std::convert::Infallible>(())
    })
    .map_err(|error| IdentifyError::Numerical(error.to_string()))
}
