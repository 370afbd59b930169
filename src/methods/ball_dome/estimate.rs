//! Identification: from plan and readings to the estimate.

use std::collections::BTreeSet;

use estimation::linear_least_squares::{RANK_THRESHOLD, analyse_rank};
use faer::Mat;
use nalgebra::{Matrix3, Vector3};

use super::error_and_stylus_fit::STYLUS_AND_POSE_UNKNOWN_COUNT;
use super::measured_points::MeasuredPoints;
use super::model::DomeModel;
use super::noise_simulation::simulate_max_and_mean_deviation_mm;
use super::prior_machine_errors::machine_errors_from_prior;
use super::settings::BallDomeSettings;
use super::variant::DomeVariant;
use super::variant_computation::{compute_variants, point_derivatives_by_prior_errors};
use super::{design, outputs, sources};
use crate::ball_measurement::{
    ObservedBalls, ball_index, measurements_for_outlier_check, observe_balls, whitening_matrices,
};
use crate::identification::{
    FitQuality, SolvedModel, TrialSettings, UncertaintySource, identify, mean_coordinate_u_mm, rms,
};
use crate::{IdentifyError, MethodRefusal};
use machine::kinematics::KinematicChain;
use machine::record::estimate::{Estimate, Parameter};
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Seed of the Monte Carlo propagation: fixed, so that the same readings give the same bytes.
const MONTE_CARLO_SEED: u64 = 0x646f_6d65;
/// Significant digits of u to which the trials must be stable if the settings select the adaptive number of trials
/// (JCGM 101, 7.9.2).
const STABLE_DIGITS: u32 = 1;
/// Maximum number of trials of the adaptive rule.
const MAX_TRIALS: usize = 20_000;

/// # Errors
/// The readings do not belong to the plan, or are too few for the artefact.
pub fn build_estimate(
    plan: &Plan,
    settings: &BallDomeSettings,
    readings: &[Reading],
) -> Result<Estimate, IdentifyError> {
    let setup = design::dome_setup(plan, settings)?;
    let known = machine_errors_from_prior(plan)?;
    let observed = observe_balls(plan, readings)?;
    check_ball_count(&observed)?;
    let chain = KinematicChain::new(&plan.machine).map_err(MethodRefusal::from)?;
    let stylus = Vector3::from(plan.machine.tool_mm);
    let points = MeasuredPoints::new(chain, stylus, &observed, setup.balls);
    let tool_ball = ball_index(setup.balls, &settings.tool_ball).unwrap_or_default();
    let (variants, lost) = compute_variants(&points, known.as_ref(), tool_ball);
    let variant_index = |name: &str| variants.iter().position(|variant| variant.kind.name == name);
    let mut sources = sources::reading_sources(plan, points.chain(), &observed);
    let compared_index = variant_index("S3");
    let weights = point_whitening_matrices(&points, &sources);
    let groups = outputs::MeasurementGroups::from_observed(&observed);
    let model = DomeModel {
        points: &points,
        variants: &variants,
        point_derivatives_by_prior_errors: &point_derivatives_by_prior_errors(&points, known.as_ref()),
        ball_count: setup.balls.balls.len(),
        chi2_variant_index: compared_index,
        group_point_indices: &groups.point_indices,
        whitening_matrices: &weights,
    };
    let u_mm = setup.balls.certificate_u_mm.unwrap_or_default();
    sources.push(sources::certificate_source(&model, u_mm));
    sources.push(sources::temperature_source(&model, setup.balls));
    sources.retain(|source| !source.is_zero());
    sources.extend(known.as_ref().and_then(|known| sources::prior_source(&model, known)));
    let best = &variants[compared_index.or_else(|| variant_index("N3")).unwrap_or(0)];
    let measurement =
        |i: usize| (best.certified_to_measured_fit.deviations[i], 3 * i, mean_coordinate_u_mm(&weights[i]));
    let solution = SolvedModel {
        model: &model,
        weighted_residuals: &compared_index
            .map_or(Vec::new(), |_| model.weighted_residuals(&best.certified_to_measured_fit.deviations)),
        has_declared_source_sizes: plan.probe.repeatability_um.is_some(),
        fit_quality: quality_of_fit(&points, best, compared_index.is_some())?,
        measurements: &compared_index.map_or(Vec::new(), |_| measurements_for_outlier_check(&observed, measurement)),
    };
    let trials = TrialSettings::new(MONTE_CARLO_SEED, settings.monte_carlo_trials, STABLE_DIGITS, MAX_TRIALS);
    let identified = identify(&solution, &sources, outputs::build_outputs(&model, &groups), Some(trials))?;
    let mut estimate = identified.estimate(super::METHOD_NAME);
    // The deviations come first: those of N1 and of the best variant, then those of the other variants.
    estimate.parameters.rotate_right(2 * variants.len());
    sort_plotted_deviations_first(&mut estimate.parameters[..2 * variants.len()], [&variants[0], best]);
    estimate.arrows = outputs::deviation_arrows(&setup, &observed, &points, [&variants[0], best]);
    estimate.functions.extend(variants.iter().map(outputs::deviation_histogram));
    Ok(Estimate {
        gauge: outputs::describe_gauge(
            setup.balls.balls.get(tool_ball).map_or("", |ball| &ball.id),
            simulate_max_and_mean_deviation_mm(&weights, &points.ball_indices, u_mm),
        ),
        not_identifiable: lost.into_iter().chain(identified.outlier_check.describe_detection_limits()).collect(),
        warnings: outputs::collect_warnings(&observed, known.is_some(), &identified),
        ..estimate
    })
}

/// Puts the deviations of the `shown` variants first: their maxima, then their means.
fn sort_plotted_deviations_first(parameters: &mut [Parameter], shown: [&DomeVariant; 2]) {
    parameters.sort_by_key(|parameter| {
        let (name, statistic) = parameter.symbol.split_once('_').unwrap_or_default();
        let is_shown = shown.iter().any(|variant| variant.kind.name == name);
        (!is_shown, is_shown && statistic == "mean")
    });
}

/// Requires at least three different measured balls.
fn check_ball_count(observed: &ObservedBalls) -> Result<(), MethodRefusal> {
    let balls: BTreeSet<usize> = observed.centres.iter().map(|centre| centre.ball_index).collect();
    MethodRefusal::require(
        balls.len() >= 3,
        format!("only {} balls were measured: the fit of the artefact position requires at least three", balls.len()),
        "continue the run, or give all readings of the run",
    )
}

/// Weight of each point, from a change in the table frame (mm) to residuals of unit variance, by `sources`.
fn point_whitening_matrices(points: &MeasuredPoints, sources: &[UncertaintySource]) -> Vec<Matrix3<f64>> {
    let weight = |(whitening, table_from_axes): (Matrix3<f64>, &Matrix3<f64>)| {
        whitening * table_from_axes.try_inverse().unwrap_or(Matrix3::repeat(f64::NAN))
    };
    whitening_matrices(sources, points.point_count()).zip(&points.table_from_axes).map(weight).collect()
}

/// Rank and condition of the equations for stylus, translation and rotation, and the residuals of the variant. If the
/// residuals are not compared with the declared sources (`is_chi2_tested` false), the degrees of freedom are 0.
fn quality_of_fit(
    points: &MeasuredPoints,
    best: &DomeVariant,
    is_chi2_tested: bool,
) -> Result<FitQuality, IdentifyError> {
    let stylus_derivatives = points.point_derivatives_by_stylus(&[]);
    let entry = |row: usize, column: usize| {
        let (i, k, j) = (row / 3, row % 3, column % 3);
        match column / 3 {
            0 => stylus_derivatives[i][(k, j)],
            1 => f64::from(u8::from(k == j)),
            _ => best.certified_to_measured_fit.rotated_points_about_centroid[i].cross_matrix()[(k, j)],
        }
    };
    let design = Mat::from_fn(3 * points.point_count(), STYLUS_AND_POSE_UNKNOWN_COUNT, entry);
    let survey = analyse_rank(design.as_ref(), None, RANK_THRESHOLD)
        .map_err(|error| IdentifyError::IdentificationFailed(error.to_string()))?;
    let coordinates: Vec<f64> = best.certified_to_measured_fit.deviations.iter().flatten().copied().collect();
    Ok(FitQuality {
        rank: survey.rank,
        unknown_count: STYLUS_AND_POSE_UNKNOWN_COUNT,
        condition_number: survey.condition,
        dof: if is_chi2_tested { (3 * points.point_count()).saturating_sub(STYLUS_AND_POSE_UNKNOWN_COUNT) } else { 0 },
        residual_rms_mm: rms(&coordinates),
    })
}
