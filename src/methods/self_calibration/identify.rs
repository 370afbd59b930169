//! Identification: from plan and readings to the estimate.

use super::design::Design;
use super::estimate;
use super::fit::{Fit, LinearisedFit};
use super::model::{Observation, UnknownsLayout};
use super::observe::{ObservedAxis, ObservedCycle, extract_observations};
use super::outputs;
use super::plan::StepPlanner;
use super::sense;
use super::settings::SelfCalibrationSettings;
use super::solved_cycle::SolvedCycle;
use super::sources::{interruption_source, rotary_axis_sources, uncertainty_sources};
use crate::identification::{
    self, KnownMotions, Measurement, Outputs, Solution, TrialPlan, UncertaintySource, block_covariances,
};
use crate::{IdentifyError, MethodRefusal};
use estimation::linear::RankAnalysis;
use estimation::null_names::name_null_space;
use machine::Axis;
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Step};
use machine::record::reading::{Reading, ReadingFlag};

/// Seed of the Monte Carlo propagation: fixed, so that the same readings give the same bytes.
const MONTE_CARLO_SEED: u64 = 0x7275_6564;
/// Significant digits of u to which the trials must be stable (JCGM 101, 7.9.2).
const STABLE_DIGITS: u32 = 2;

/// Maximum number of undetermined combinations of unknowns that are named. For the paper's unknowns there are
/// dozens.
const MAX_NAMED_COMBINATIONS: usize = 4;

/// Trials of the Monte Carlo propagation. The adaptive rule has a limit of 200 000 trials, fewer for large designs,
/// so that it takes seconds. It usually stops earlier.
fn trial_plan(settings: &SelfCalibrationSettings, fit: &Fit) -> TrialPlan {
    let products = (fit.design_matrix.nrows() * fit.design_matrix.ncols()).max(1);
    let max = (4_000_000_000 / products).clamp(10_000, 200_000);
    TrialPlan::new(MONTE_CARLO_SEED, settings.monte_carlo_trials, STABLE_DIGITS, max)
}

/// Refuses, before the first move, a cycle whose readings do not separate the unknowns: checks the rank of the
/// nominal design, including drift and heights.
pub fn check_well_posed(
    plan: &Plan,
    settings: &SelfCalibrationSettings,
    planner: &StepPlanner<'_>,
) -> Result<(), MethodRefusal> {
    let mut plan = plan.clone();
    plan.steps = planner.cycle_steps(planner.nominal_part())?;
    let readings: Vec<Reading> = plan.steps.iter().map(nominal_reading).collect();
    let refused = |reason: IdentifyError| MethodRefusal {
        reason: format!("this cycle does not separate the unknowns: {reason}"),
        remedy: "lower drift_order, keep references = true, or increase the distance between the heights".to_owned(),
    };
    let (heights, known_motions) = (planner.heights(), KnownMotions::default());
    let axis = ObservedAxis { axis: planner.axis(), heights: &heights, known_motions: &known_motions };
    let (layout, observed) = observe_cycle(&plan, settings, &axis, &readings).map_err(refused)?;
    let sigma = vec![1.0; observed.observations.len()];
    let axis = planner.axis().axis;
    fit_observations(axis, layout, observed.observations, sigma, settings).map(drop).map_err(refused)
}

/// A reading at the start of its touch. Only its position in the design is used.
pub fn nominal_reading(step: &Step) -> Reading {
    Reading {
        step: step.id,
        repeat: 0,
        position: step.from.clone(),
        value_mm: None,
        sensor: step.first_sensor().to_owned(),
        t_s: f64::from(step.id) + 1.0,
        flag: ReadingFlag::None,
        temperatures_c: Default::default(),
    }
}

fn observe_cycle(
    plan: &Plan,
    settings: &SelfCalibrationSettings,
    axis: &ObservedAxis<'_>,
    readings: &[Reading],
) -> Result<(UnknownsLayout, ObservedCycle), IdentifyError> {
    let design = Design::new(settings)?;
    let observed = extract_observations(plan, &design, axis, readings)?;
    let (drift_order, gaps) = (settings.drift_order, observed.gaps.clone());
    Ok((UnknownsLayout { design, heights: axis.heights.len(), drift_order, gaps }, observed))
}

/// The solved fit of one plan's readings, with the sources of its uncertainty.
pub struct FittedCycle {
    pub fit: Fit,
    pub sources: Vec<UncertaintySource>,
    pub outputs: Outputs,
    has_times: bool,
    skipped_readings: usize,
}

/// # Errors
/// The errors of [`identify`].
pub fn fit_cycle(
    plan: &Plan,
    settings: &SelfCalibrationSettings,
    axis: &ObservedAxis<'_>,
    readings: &[Reading],
) -> Result<FittedCycle, IdentifyError> {
    let (layout, observed) = observe_cycle(plan, settings, axis, readings)?;
    let ObservedCycle { observations, half_duration_s, has_times, skipped_readings, .. } = observed;
    let (spindle, heights) = (settings.spindle, axis.heights);
    let mut sources = uncertainty_sources(plan, &layout, &observations, spindle, half_duration_s, heights);
    sources.extend(rotary_axis_sources(plan, &layout, &observations, axis));
    let variances = block_covariances::<1>(&sources, observations.len());
    let sigma = variances.iter().map(|variance| variance[0].sqrt()).collect();
    let name = axis.axis.axis;
    let fit = fit_observations(name, layout, observations, sigma, settings)?;
    if !fit.layout.gaps.is_empty() {
        sources.push(interruption_source(&fit.layout, &fit.observations, &fit.x));
    }
    let outputs = outputs::build_outputs(&fit.layout, name, axis.heights, &fit.x);
    Ok(FittedCycle { fit, sources, outputs, has_times, skipped_readings })
}

/// Identifies the readings of one plan.
pub fn identify(
    plan: &Plan,
    settings: &SelfCalibrationSettings,
    planner: &StepPlanner<'_>,
    known_motions: &KnownMotions<'_>,
    readings: &[Reading],
) -> Result<Estimate, IdentifyError> {
    let trials = |fit: &Fit| Some(trial_plan(settings, fit));
    Ok(estimate::build_estimate(&solve_cycle(plan, settings, planner, known_motions, readings, trials)?))
}

/// The solved cycle with its uncertainty.
///
/// # Errors
/// The errors of [`identify`].
pub fn solve_cycle<'a>(
    plan: &'a Plan,
    settings: &'a SelfCalibrationSettings,
    planner: &'a StepPlanner<'_>,
    known_motions: &'a KnownMotions<'a>,
    readings: &[Reading],
    trials: impl Fn(&Fit) -> Option<TrialPlan>,
) -> Result<SolvedCycle<'a>, IdentifyError> {
    let (heights, axis) = (planner.heights(), planner.axis());
    let observed = ObservedAxis { axis, heights: &heights, known_motions };
    let FittedCycle { fit, sources, outputs, has_times, skipped_readings } =
        fit_cycle(plan, settings, &observed, readings)?;
    let residuals = fit.residuals();
    let weighted: Vec<f64> = residuals.iter().zip(&fit.sigma).map(|(r, s)| r / s).collect();
    let solution = Solution {
        model: &LinearisedFit::new(&fit),
        residuals: &weighted,
        has_declared_sizes: plan.probe.repeatability_um.is_some(),
        figures: fit.figures(&residuals),
        measurements: &touch_measurements(plan, &fit, &residuals),
    };
    let identification = identification::identify(&solution, &sources, outputs, trials(&fit))?;
    let sense = sense::check_sense(&fit);
    Ok(SolvedCycle {
        plan,
        settings,
        axis,
        heights,
        known_motions,
        fit,
        identification,
        sense,
        has_times,
        skipped_readings,
    })
}

/// One measurement per touch. Deviations are along the ray, positive outward.
fn touch_measurements(plan: &Plan, fit: &Fit, residuals: &[f64]) -> Vec<Measurement> {
    let label = |id: u32| {
        let step = plan.steps.iter().find(|step| step.id == id);
        step.map_or_else(|| id.to_string(), |step| step.label.clone())
    };
    let all = fit.observations.iter().zip(residuals).zip(&fit.sigma).enumerate();
    let measurement = |(i, ((observation, residual), sigma)): (usize, ((&Observation, &f64), &f64))| {
        let label = label(observation.step);
        let in_words = format!("touch {label}");
        Measurement { label, description: in_words, rows: i..i + 1, residual_mm: *residual, u_mm: *sigma }
    };
    all.map(measurement).collect()
}

fn fit_observations(
    axis: Axis,
    layout: UnknownsLayout,
    observations: Vec<Observation>,
    sigma: Vec<f64>,
    settings: &SelfCalibrationSettings,
) -> Result<Fit, IdentifyError> {
    let names = layout.names(axis);
    let lost = |survey: &RankAnalysis| truncate_lines(name_null_space(survey.null_space.as_ref(), &names));
    Fit::new(layout, observations, sigma, settings.second_order)
        .map_err(|error| IdentifyError::from_solver_error(error, lost))
}

/// The first lines, and the number of omitted lines.
fn truncate_lines(mut lines: Vec<String>) -> Vec<String> {
    let more = lines.len().saturating_sub(MAX_NAMED_COMBINATIONS);
    lines.truncate(MAX_NAMED_COMBINATIONS);
    lines.extend((more > 0).then(|| format!("and {more} more")));
    lines
}
