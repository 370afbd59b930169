//! Identification: from plan and readings to the estimate.

use super::fit::{FitWithSensitivity, SelfCalibrationFit};
use super::model::{RadiusObservation, UnknownsLayout};
use super::observe::{ObservedReadings, extract_observations};
use super::outputs;
use super::rotation_sense::{self, RotationSenseCheck};
use super::setup::SelfCalibrationSetup;
use super::sources::{interruption_step_source, rotary_axis_sources, uncertainty_sources};
use crate::identification::{
    self, Identification, IdentificationOutputs, MeasurementToCheck, SolvedModel, TrialSettings, UncertaintySource,
    block_covariances,
};
use crate::{IdentifyError, MethodRefusal};
use estimation::linear_least_squares::RankAnalysis;
use estimation::null_space_names::name_null_space;
use machine::record::plan::{Plan, Step};
use machine::record::reading::Reading;

/// Seed of the Monte Carlo propagation: fixed, so that the same readings give the same bytes.
const MONTE_CARLO_SEED: u64 = 0x7275_6564;
/// Significant digits of u to which the trials must be stable (JCGM 101, 7.9.2).
const STABLE_U_DIGITS: u32 = 2;

/// Maximum number of undetermined combinations of unknowns that are named. For the paper's unknowns there are
/// dozens.
const MAX_NAMED_COMBINATIONS: usize = 4;

/// Trials of the Monte Carlo propagation. The adaptive rule has a limit of 200 000 trials, fewer for large designs,
/// so that it takes seconds. It usually stops earlier.
fn trial_settings(monte_carlo_trials: usize, fit: &SelfCalibrationFit) -> TrialSettings {
    let products = (fit.design_matrix.nrows() * fit.design_matrix.ncols()).max(1);
    let max = (4_000_000_000 / products).clamp(10_000, 200_000);
    TrialSettings::new(MONTE_CARLO_SEED, monte_carlo_trials, STABLE_U_DIGITS, max)
}

/// Refuses, before the first move, a plan whose readings do not separate the unknowns: checks the rank of the
/// nominal design, including drift and heights.
pub fn check_well_posed(setup: &SelfCalibrationSetup<'_>) -> Result<(), MethodRefusal> {
    let steps = setup.plan.number_steps(0, setup.steps_after_locating(setup.nominal_part())?);
    let plan = Plan { steps, ..setup.plan.clone() };
    let readings: Vec<Reading> = plan.steps.iter().map(reading_at_touch_start).collect();
    let nominal = SelfCalibrationSetup::new(&plan, setup.settings)?;
    let fitted = observe_readings(&nominal, &readings).and_then(|(layout, observed)| {
        let sigma = vec![1.0; observed.observations.len()];
        fit_observations(&nominal, layout, observed.observations, sigma)
    });
    fitted.map(drop).map_err(|reason| {
        MethodRefusal::new(
            format!("this cycle does not separate the unknowns: {reason}"),
            "lower drift_order, keep references = true, or increase the distance between the heights",
        )
    })
}

/// A reading at the start of its touch, at the time step id + 1, s, so that the readings have different times.
pub fn reading_at_touch_start(step: &Step) -> Reading {
    Reading::at_touch_start(step, f64::from(step.id) + 1.0)
}

fn observe_readings(
    setup: &SelfCalibrationSetup<'_>,
    readings: &[Reading],
) -> Result<(UnknownsLayout, ObservedReadings), IdentifyError> {
    let observed = extract_observations(setup, readings)?;
    let layout = UnknownsLayout {
        design: setup.design.clone(),
        height_count: setup.heights_in_machine_mm.len(),
        drift_order: setup.settings.drift_order,
        interruption_times: observed.interruption_times.clone(),
    };
    Ok((layout, observed))
}

/// The solved fit of all readings of a run, with the sources of its uncertainty.
pub struct FittedRun {
    pub fit: SelfCalibrationFit,
    pub sources: Vec<UncertaintySource>,
    pub outputs: IdentificationOutputs,
    /// Whether the readings have times.
    has_times: bool,
    /// Number of readings that are not used: too few directions were touched between their interruptions.
    short_segment_reading_count: usize,
}

/// Fits all readings with the error motions in `setup.known_motions` subtracted.
///
/// # Errors
/// Readings are missing, do not belong to the plan, or do not separate the unknowns.
pub fn fit_readings(setup: &SelfCalibrationSetup<'_>, readings: &[Reading]) -> Result<FittedRun, IdentifyError> {
    let (layout, observed) = observe_readings(setup, readings)?;
    let ObservedReadings { observations, half_duration_s, has_times, short_segment_reading_count, .. } = observed;
    let mut sources = uncertainty_sources(setup, &layout, &observations, half_duration_s);
    sources.extend(rotary_axis_sources(setup, &layout, &observations));
    let variances = block_covariances::<1>(&sources, observations.len());
    let sigma = variances.iter().map(|variance| variance[0].sqrt()).collect();
    let fit = fit_observations(setup, layout, observations, sigma)?;
    if !fit.layout.interruption_times.is_empty() {
        sources.push(interruption_step_source(&fit.layout, &fit.observations, &fit.x));
    }
    let outputs = outputs::build_outputs(&fit.layout, setup.axis.axis, &setup.heights_in_machine_mm, &fit.x);
    Ok(FittedRun { fit, sources, outputs, has_times, short_segment_reading_count })
}

/// The solved readings of a run with their uncertainty, from which the estimate is written.
pub struct SolvedRun<'a> {
    pub setup: &'a SelfCalibrationSetup<'a>,
    pub fit: SelfCalibrationFit,
    pub identification: Identification,
    pub rotation_sense_check: RotationSenseCheck,
    /// Whether the readings have times. If not, their order and the planned machine time are used.
    pub has_times: bool,
    /// Number of readings that are not used: too few directions were touched between their interruptions.
    pub short_segment_reading_count: usize,
}

/// Solves for the unknowns from all readings of the run. `with_trials`: whether Monte Carlo trials are computed.
///
/// # Errors
/// The errors of [`fit_readings`].
pub fn solve_readings<'a>(
    setup: &'a SelfCalibrationSetup<'a>,
    readings: &[Reading],
    with_trials: bool,
) -> Result<SolvedRun<'a>, IdentifyError> {
    let FittedRun { fit, sources, outputs, has_times, short_segment_reading_count } = fit_readings(setup, readings)?;
    let residuals = fit.residuals();
    let weighted: Vec<f64> = residuals.iter().zip(&fit.sigma).map(|(r, s)| r / s).collect();
    let solution = SolvedModel {
        model: &FitWithSensitivity::new(&fit),
        weighted_residuals: &weighted,
        has_declared_source_sizes: setup.plan.probe.repeatability_um.is_some(),
        fit_quality: fit.quality_of_fit(&residuals),
        measurements: &touch_measurements(setup.plan, &fit, &residuals),
    };
    let trials = with_trials.then(|| trial_settings(setup.settings.monte_carlo_trials, &fit));
    let identification = identification::identify(&solution, &sources, outputs, trials)?;
    let rotation_sense_check = rotation_sense::check_rotation_sense(&fit);
    Ok(SolvedRun { setup, fit, identification, rotation_sense_check, has_times, short_segment_reading_count })
}

/// One measurement per observation: a repeat is a separate measurement with the same label. Deviations are along the
/// ray, positive outward.
fn touch_measurements(plan: &Plan, fit: &SelfCalibrationFit, residuals: &[f64]) -> Vec<MeasurementToCheck> {
    let label = |id: u32| {
        let step = plan.steps.iter().find(|step| step.id == id);
        step.map_or_else(|| id.to_string(), |step| step.label.clone())
    };
    let all = fit.observations.iter().zip(residuals).zip(&fit.sigma).enumerate();
    let measurement = |(i, ((observation, residual), sigma)): (usize, ((&RadiusObservation, &f64), &f64))| {
        let label = label(observation.step_id);
        let in_words = format!("touch {label}");
        MeasurementToCheck {
            label,
            description: in_words,
            residual_rows: i..i + 1,
            residual_mm: *residual,
            u_mm: *sigma,
            mean_time_s: observation.time_s,
        }
    };
    all.map(measurement).collect()
}

fn fit_observations(
    setup: &SelfCalibrationSetup<'_>,
    layout: UnknownsLayout,
    observations: Vec<RadiusObservation>,
    sigma: Vec<f64>,
) -> Result<SelfCalibrationFit, IdentifyError> {
    let names = layout.unknown_names(setup.axis.axis);
    let lost = |survey: &RankAnalysis| truncate_lines(name_null_space(survey.null_space.as_ref(), &names));
    SelfCalibrationFit::new(layout, observations, sigma, setup.settings.second_order)
        .map_err(|error| IdentifyError::from_solver_error(error, lost))
}

/// The first lines, and the number of omitted lines.
fn truncate_lines(mut lines: Vec<String>) -> Vec<String> {
    let more = lines.len().saturating_sub(MAX_NAMED_COMBINATIONS);
    lines.truncate(MAX_NAMED_COMBINATIONS);
    lines.extend((more > 0).then(|| format!("and {more} more")));
    lines
}
