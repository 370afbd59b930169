//! Identification: from plan and readings to the estimate.

use nalgebra::{Matrix3, Vector3};

use super::combined_fit::{CombinedFit, centre_covariances, observation_sensitivities};
use super::latency::LatencyEstimate;
use super::observe::{ObservedScans, observe_scans};
use super::outputs;
use super::parameter_selection;
use super::pose_groups::{GroupedScans, PoseGroup, group_scans};
use super::result::IdentificationResult;
use super::scan_purpose::ScanPurpose;
use super::setup::LaserSetup;
use super::sources::uncertainty_sources;
use super::sphere_model::{CentreObservation, MachineEquations, SphereModel};
use crate::identification::{
    self, FitQuality, MeasurementToCheck, NonlinearFit, SolvedModel, TrialSettings, mean_coordinate_u_mm,
};
use crate::{IdentifyError, MethodRefusal};
use estimation::linear_least_squares::{LinearError, RankAnalysis};
use estimation::nonlinear_least_squares::{NonlinearError, NonlinearSolution};
use estimation::null_space_names::name_null_space;
use estimation::whitening::whitening_matrix;
use machine::frame::unit_vector;
use machine::record::estimate::Estimate;
use machine::record::reading::Reading;

const MONTE_CARLO_SEED: u64 = 0x6c61_7365;
/// Maximum number of trials of the adaptive Monte Carlo propagation. It limits the run time to seconds.
const MAX_TRIALS: usize = 40_000;
/// Significant digits of u to which the trials must be stable (JCGM 101, 7.9.2).
const STABLE_DIGITS: u32 = 1;

pub fn identify(setup: &LaserSetup<'_>, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
    Ok(outputs::build_estimate(&identify_scans(setup, readings)?))
}

/// # Errors
/// The readings belong to another plan, are too few, or do not determine the unknowns.
pub fn identify_scans<'a>(
    setup: &'a LaserSetup<'a>,
    readings: &[Reading],
) -> Result<IdentificationResult<'a>, IdentifyError> {
    let (observed, grouped, centre_fit) = fit_centres(setup, readings)?;
    let settings = setup.settings;
    let selection = parameter_selection::select_parameters(&setup.chain, &settings.parameters, &settings.harmonics)?;
    let names = parameter_selection::unknown_names(&selection.parameters, &setup.ball.id);
    let centres = NonlinearFit { equation: &grouped.centre_equations, minimum: &centre_fit };
    let gain = observation_sensitivities(&centres);
    let latency_index = names.len() + grouped.centre_equations.beam_unknown_count();
    let sources = uncertainty_sources(setup, &observed, &grouped, &centre_fit.x, latency_index);
    let covariances = centre_covariances(&grouped.centre_equations, &gain, &sources);
    let centre_observations = centre_observations(&grouped, &centre_fit.x, covariances);
    let model = SphereModel { chain: setup.chain.clone(), parameters: selection.parameters.clone() };
    let problem = MachineEquations { model, centre_observations, zero_point_prior: None };
    let (survey, minimum) = solve_machine_errors(setup, &problem, &names)?;
    let latency = observed.latency.as_ref().map_or_else(Vec::new, LatencyEstimate::values_of_unknowns);
    let x = [&minimum.x, &centre_fit.x[..grouped.centre_equations.beam_unknown_count()], &latency].concat();
    let machine = NonlinearFit { equation: &problem, minimum: &minimum };
    let (groups, latency) = (&grouped.groups, latency.len());
    let residuals = outputs::position_residuals(&problem, groups, &minimum.x);
    let measurements = pose_measurements_to_check(&problem, &grouped, &residuals);
    let solution = SolvedModel {
        model: &CombinedFit {
            centre_fit: centres,
            centre_gain_matrix: &gain,
            machine_fit: machine,
            groups,
            latency_unknown_count: latency,
        },
        weighted_residuals: &minimum.residuals,
        has_declared_source_sizes: setup.sensor.noise_um.is_some(),
        fit_quality: FitQuality::from_nonlinear_fit(&survey, &minimum, &residuals),
        measurements: &measurements,
    };
    let outputs = outputs::build_outputs(&problem, &names, observed.latency.as_ref(), &x);
    let plan = TrialSettings::new(MONTE_CARLO_SEED, settings.monte_carlo_trials, STABLE_DIGITS, MAX_TRIALS);
    let identified = identification::identify(&solution, &sources, outputs, Some(plan))?;
    Ok(IdentificationResult {
        setup,
        observed,
        grouped,
        centre_fit,
        selection,
        machine_equations: problem,
        machine_fit: minimum,
        unknown_names: names,
        identification: identified,
    })
}

/// Fits the sphere's centres and the beam from the samples within the incidence limit.
fn fit_centres(
    setup: &LaserSetup<'_>,
    readings: &[Reading],
) -> Result<(ObservedScans, GroupedScans, NonlinearSolution), IdentifyError> {
    let mut observed = observe_scans(setup, readings)?;
    let (mut grouped, mut centre_fit) = group_scans_and_solve_centres(setup, &mut observed)?;
    if !setup.uses_touch_probe() && remove_oblique_samples(setup, &mut observed, &grouped, &centre_fit) {
        (grouped, centre_fit) = group_scans_and_solve_centres(setup, &mut observed)?;
    }
    Ok((observed, grouped, centre_fit))
}

fn group_scans_and_solve_centres(
    setup: &LaserSetup<'_>,
    observed: &mut ObservedScans,
) -> Result<(GroupedScans, NonlinearSolution), IdentifyError> {
    let grouped = group_scans(setup, observed)?;
    check_heights_determine_beam_direction(setup, observed, &grouped)?;
    let failed = |error: NonlinearError| IdentifyError::IdentificationFailed(format!("fit of the spheres: {error}"));
    let centre_fit = grouped.centre_equations.solve().map_err(failed)?;
    Ok((grouped, centre_fit))
}

fn check_heights_determine_beam_direction(
    setup: &LaserSetup<'_>,
    observed: &ObservedScans,
    grouped: &GroupedScans,
) -> Result<(), MethodRefusal> {
    let count = grouped.max_heights_per_group;
    let is_height = |line: &&String| ScanPurpose::from_step_label(line) == Some(ScanPurpose::BeamDirection);
    let missing = match observed.skipped_scans.iter().filter(is_height).cloned().collect::<Vec<_>>().as_slice() {
        [] => String::new(),
        lines => format!(" ({})", lines.join("; ")),
    };
    MethodRefusal::require(
        grouped.centre_equations.is_beam_free || setup.uses_touch_probe(),
        format!(
            "the beam direction needs scans at three heights, the readings have {count}{missing}; from one height its \
             uncertainty is hundreds of urad"
        ),
        "measure the stage `beam direction` at three heights_mm that are well apart, each along two lines that cross \
         at the pole",
    )
}

/// Removes and counts samples beyond the incidence limit. Returns whether there were any.
fn remove_oblique_samples(
    setup: &LaserSetup<'_>,
    observed: &mut ObservedScans,
    grouped: &GroupedScans,
    centre_fit: &NonlinearSolution,
) -> bool {
    let centres = &grouped.centre_equations;
    let beam = unit_vector(centres.beam_vector(&centre_fit.x)).unwrap_or_default();
    let mut oblique_scan_and_point_indices: Vec<(usize, usize)> = Vec::new();
    for (row, origin) in centres.scan_points.iter().zip(&grouped.row_scan_and_point_indices) {
        let towards = -(row.machine_from_spindle * beam);
        if centres.centre_to_spot(&centre_fit.x, row).angle(&towards) > setup.incidence_limit_rad() {
            oblique_scan_and_point_indices.push(*origin);
        }
    }
    // Remove from the end, so that the remaining indices stay valid.
    oblique_scan_and_point_indices.sort_unstable_by(|a, b| b.cmp(a));
    for (scan, point) in &oblique_scan_and_point_indices {
        let spot = observed.scans[*scan].sample_means.remove(*point);
        *observed.excluded_sample_counts_by_reason.entry("beyond the incidence limit").or_default() +=
            spot.sample_count;
    }
    !oblique_scan_and_point_indices.is_empty()
}

/// Observations at the centres of the fit `x`, with their `covariances` in the machine frame.
fn centre_observations(grouped: &GroupedScans, x: &[f64], covariances: Vec<Matrix3<f64>>) -> Vec<CentreObservation> {
    let groups = grouped.groups.iter().enumerate().zip(covariances);
    let observation = |((i, group), covariance): ((usize, &PoseGroup), Matrix3<f64>)| CentreObservation {
        axis_positions: group.axis_positions(grouped.centre_equations.group_centre(x, i)),
        whitening_matrix: whitening_matrix(covariance) * group.machine_from_table,
    };
    groups.map(observation).collect()
}

/// The measurement of the sphere's centre at each pose, with its residual, for the check for outliers.
fn pose_measurements_to_check(
    problem: &MachineEquations,
    grouped: &GroupedScans,
    residuals: &[Vector3<f64>],
) -> Vec<MeasurementToCheck> {
    let measurement = |(i, group): (usize, &PoseGroup)| MeasurementToCheck {
        label: group.label.clone(),
        description: format!("the sphere at {}", group.label),
        residual_rows: 3 * i..3 * i + 3,
        residual_mm: residuals[i].norm(),
        u_mm: mean_coordinate_u_mm(&problem.centre_observations[i].whitening_matrix),
        mean_time_s: grouped.mean_time_of_group_s(i),
    };
    grouped.groups.iter().enumerate().map(measurement).collect()
}

fn solve_machine_errors(
    setup: &LaserSetup<'_>,
    problem: &MachineEquations,
    names: &[String],
) -> Result<(RankAnalysis, NonlinearSolution), IdentifyError> {
    let errors = vec![0.0; problem.model.parameters.len()];
    let start = [&errors, setup.zero_point().as_slice(), setup.ball_centre().as_slice()].concat();
    let unsolved = |why: NonlinearError| {
        IdentifyError::from_solver_error(why, |lost| name_null_space(lost.null_space.as_ref(), names))
    };
    let survey = problem.analyse_rank(&start).map_err(unsolved)?;
    if survey.nullity > 0 {
        return Err(unsolved(LinearError::RankDeficient(Box::new(survey)).into()));
    }
    let minimum = problem.solve(start).map_err(unsolved)?;
    Ok((survey, minimum))
}
