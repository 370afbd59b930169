//! Identification: from plan and readings to the estimate.

use super::design::Design;
use super::estimate;
use super::fit::{Fit, LinearisedFit};
use super::model::{Layout, Observation};
use super::observe::{Observed, ObservedAxis, observe};
use super::outputs;
use super::parts::Parts;
use super::plan::Planner;
use super::sense;
use super::settings::Settings;
use super::sources::{interruptions, rotary_axis, sources};
use crate::identification::{
    self, KnownMotions, Measurement, Outputs, Solution, TrialPlan, UncertaintySource,
    block_covariances,
};
use crate::{IdentifyError, Refused};
use estimation::linear::Survey;
use estimation::monte_carlo::Trials;
use estimation::null_names::name_null_space;
use machine::Axis;
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Step};
use machine::record::reading::{Flag, Reading};

/// Seed of the Monte Carlo propagation: fixed, so that the same readings give the same bytes.
const MONTE_CARLO_SEED: u64 = 0x7275_6564;
/// Significant digits of u to which the trials must be stable (JCGM 101, 7.9.2).
const STABLE_DIGITS: u32 = 2;

/// Maximum number of undetermined combinations of unknowns that are named. For the paper's unknowns there are
/// dozens.
const MAX_NAMED_LOST: usize = 4;

/// Trials of the Monte Carlo propagation. The adaptive rule has a limit of 200 000 trials, fewer for large designs,
/// so that it takes seconds. It usually stops earlier.
fn trial_plan(settings: &Settings, fit: &Fit) -> TrialPlan {
    let products = (fit.a.nrows() * fit.a.ncols()).max(1);
    let max = (4_000_000_000 / products).clamp(10_000, 200_000);
    let trials = Trials::asked(settings.monte_carlo_trials, STABLE_DIGITS, max);
    TrialPlan { seed: MONTE_CARLO_SEED, trials }
}

/// Refuses, before the first move, a cycle whose readings do not separate the unknowns: checks the rank of the
/// nominal design, including drift and heights.
pub fn check_well_posed(
    plan: &Plan,
    settings: &Settings,
    planner: &Planner<'_>,
) -> Result<(), Refused> {
    let mut plan = plan.clone();
    plan.steps = planner.cycle_steps(planner.nominal_part())?;
    let readings: Vec<Reading> = plan.steps.iter().map(nominal_reading).collect();
    let refused = |why: IdentifyError| Refused {
        why: format!("this cycle cannot tell its unknowns apart: {why}"),
        instead: "lower drift_order, keep references = true, or put the heights further apart"
            .to_owned(),
    };
    let (heights, known) = (planner.heights(), KnownMotions::default());
    let axis = ObservedAxis { axis: planner.axis(), heights: &heights, known: &known };
    let (layout, observed) = observe_cycle(&plan, settings, &axis, &readings).map_err(refused)?;
    let sigma = vec![1.0; observed.observations.len()];
    let axis = planner.axis().axis;
    fit(axis, layout, observed.observations, sigma, settings).map(drop).map_err(refused)
}

/// A reading at the start of its touch. Only its position in the design is used.
pub fn nominal_reading(step: &Step) -> Reading {
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

fn observe_cycle(
    plan: &Plan,
    settings: &Settings,
    axis: &ObservedAxis<'_>,
    readings: &[Reading],
) -> Result<(Layout, Observed), IdentifyError> {
    let design = Design::new(settings)?;
    let observed = observe(plan, &design, axis, readings)?;
    let (drift_order, gaps) = (settings.drift_order, observed.gaps.clone());
    Ok((Layout { design, heights: axis.heights.len(), drift_order, gaps }, observed))
}

/// The solved fit of one plan's readings, with the sources of its uncertainty.
pub struct Fitted {
    pub fit: Fit,
    pub sources: Vec<UncertaintySource>,
    pub outputs: Outputs,
    timed: bool,
    left_out: usize,
}

/// # Errors
/// The errors of [`identify`].
pub fn fitted(
    plan: &Plan,
    settings: &Settings,
    axis: &ObservedAxis<'_>,
    readings: &[Reading],
) -> Result<Fitted, IdentifyError> {
    let (layout, observed) = observe_cycle(plan, settings, axis, readings)?;
    let Observed { observations, half_duration_s, timed, left_out, .. } = observed;
    let (spindle, heights) = (settings.spindle, axis.heights);
    let mut sources = sources(plan, &layout, &observations, spindle, half_duration_s, heights);
    sources.extend(rotary_axis(plan, &layout, &observations, axis));
    let variances = block_covariances::<1>(&sources, observations.len());
    let sigma = variances.iter().map(|variance| variance[0].sqrt()).collect();
    let name = axis.axis.axis;
    let fit = fit(name, layout, observations, sigma, settings)?;
    if !fit.layout.gaps.is_empty() {
        sources.push(interruptions(&fit.layout, &fit.observations, &fit.x));
    }
    let outputs = outputs::outputs(&fit.layout, name, axis.heights, &fit.x);
    Ok(Fitted { fit, sources, outputs, timed, left_out })
}

/// Identifies the readings of one plan.
pub fn identify(
    plan: &Plan,
    settings: &Settings,
    planner: &Planner<'_>,
    known: &KnownMotions<'_>,
    readings: &[Reading],
) -> Result<Estimate, IdentifyError> {
    let trials = |fit: &Fit| Some(trial_plan(settings, fit));
    Ok(estimate::estimate(&parts(plan, settings, planner, known, readings, trials)?))
}

/// The solved cycle with its uncertainty.
///
/// # Errors
/// The errors of [`identify`].
pub fn parts<'a>(
    plan: &'a Plan,
    settings: &'a Settings,
    planner: &'a Planner<'_>,
    known: &'a KnownMotions<'a>,
    readings: &[Reading],
    trials: impl Fn(&Fit) -> Option<TrialPlan>,
) -> Result<Parts<'a>, IdentifyError> {
    let (heights, axis) = (planner.heights(), planner.axis());
    let observed = ObservedAxis { axis, heights: &heights, known };
    let Fitted { fit, sources, outputs, timed, left_out } =
        fitted(plan, settings, &observed, readings)?;
    let residuals = fit.residuals();
    let weighted: Vec<f64> = residuals.iter().zip(&fit.sigma).map(|(r, s)| r / s).collect();
    let solution = Solution {
        model: &LinearisedFit::new(&fit),
        residuals: &weighted,
        is_declared: plan.probe.repeatability_um.is_some(),
        figures: fit.figures(&residuals),
        measurements: &measurements(plan, &fit, &residuals),
    };
    let identification = identification::identify(&solution, &sources, outputs, trials(&fit))?;
    let sense = sense::judge(&fit);
    Ok(Parts { plan, settings, axis, heights, known, fit, identification, sense, timed, left_out })
}

/// One measurement per touch. Deviations are along the ray, positive outward.
fn measurements(plan: &Plan, fit: &Fit, residuals: &[f64]) -> Vec<Measurement> {
    let label = |id: u32| {
        let step = plan.steps.iter().find(|step| step.id == id);
        step.map_or_else(|| id.to_string(), |step| step.label.clone())
    };
    let all = fit.observations.iter().zip(residuals).zip(&fit.sigma).enumerate();
    let measurement = |(i, ((seen, residual), sigma)): (usize, ((&Observation, &f64), &f64))| {
        let label = label(seen.step);
        let in_words = format!("touch {label}");
        Measurement { label, in_words, rows: i..i + 1, residual_mm: *residual, u_mm: *sigma }
    };
    all.map(measurement).collect()
}

fn fit(
    axis: Axis,
    layout: Layout,
    observations: Vec<Observation>,
    sigma: Vec<f64>,
    settings: &Settings,
) -> Result<Fit, IdentifyError> {
    let names = layout.names(axis);
    let lost = |survey: &Survey| a_few(name_null_space(survey.null_space.as_ref(), &names));
    Fit::new(layout, observations, sigma, settings.second_order)
        .map_err(|error| IdentifyError::unsolved(error, lost))
}

/// The first lines, and the number of omitted lines.
fn a_few(mut lines: Vec<String>) -> Vec<String> {
    let more = lines.len().saturating_sub(MAX_NAMED_LOST);
    lines.truncate(MAX_NAMED_LOST);
    lines.extend((more > 0).then(|| format!("and {more} more")));
    lines
}
