//! Identification: from plan and readings to the estimate.

use estimation::linear::{RANK_THRESHOLD, RankAnalysis, analyse_rank};
use estimation::whitening::whitening_matrix;
use faer::Mat;
use nalgebra::{Matrix3, Vector3};

use super::model::DomeModel;
use super::noise::simulate_noise_mm;
use super::points::MeasuredPoints;
use super::prior::machine_errors_from_prior;
use super::settings::BallDomeSettings;
use super::stylus_fit::{compute_variants, prior_error_derivatives};
use super::variant::DomeVariant;
use super::{design, outputs, sources};
use crate::ball_measurement::{MeasurementSetup, ObservedBalls, observe_balls, outlier_measurements};
use crate::identification::{
    FitQuality, Measurement, Solution, TrialPlan, UncertaintySource, block_covariances, identify, mean_coordinate_u_mm,
    rms,
};
use crate::{IdentifyError, MethodRefusal};
use machine::kinematics::KinematicChain;
use machine::record::estimate::{Estimate, Parameter};
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Seed of the Monte Carlo propagation: fixed, so that the same readings give the same bytes.
const MONTE_CARLO_SEED: u64 = 0x646f_6d65;
/// Significant digits of u to which the trials must be stable (JCGM 101, 7.9.2).
const STABLE_DIGITS: u32 = 1;
const MAX_TRIALS: usize = 20_000;
/// Minimum standard uncertainty of a measurement in the weights, mm.
const MIN_U_MM: f64 = 1e-6;
/// Number of unknowns of a variant with a stylus: stylus, translation and rotation of the artefact.
const UNKNOWN_COUNT: usize = 9;

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
    let tool_ball = tool_ball_index(&setup, settings);
    let (variants, lost) = compute_variants(&points, known.as_ref(), tool_ball);
    let of_readings = sources::reading_sources(plan, points.chain(), &observed);
    let judged = known.as_ref().and_then(|_| variants.iter().position(|v| v.kind.name == "S3"));
    let weights = point_weights(&points, &of_readings);
    let groups = outputs::MeasurementGroups::from_observed(&observed);
    let model = DomeModel {
        points: &points,
        variants: &variants,
        error_derivatives: &prior_error_derivatives(&points, known.as_ref()),
        ball_count: setup.balls.balls.len(),
        judged_variant: judged,
        groups: &groups.point_indices,
        weights: &weights,
    };
    let mut sources = of_readings;
    let u_mm = setup.balls.certificate_u_mm.unwrap_or_default();
    sources.push(sources::certificate_source(&model, u_mm));
    sources.push(sources::temperature_source(&model, setup.balls));
    sources.retain(|source| !source.is_zero());
    sources.extend(known.as_ref().and_then(|known| sources::prior_source(&model, known)));
    let best = &variants[judged.or_else(|| variant_index(&variants, "N3")).unwrap_or(0)];
    let compared = judged.map_or(Vec::new(), |i| variant_measurements(&observed, &variants[i], &weights));
    let solution = Solution {
        model: &model,
        residuals: &judged.map_or(Vec::new(), |i| model.weighted_residuals(&variants[i].fit.deviations)),
        has_declared_sizes: plan.probe.repeatability_um.is_some(),
        figures: fit_figures(&points, best, judged.is_some())?,
        measurements: &compared,
    };
    let trials = TrialPlan::new(MONTE_CARLO_SEED, settings.monte_carlo_trials, STABLE_DIGITS, MAX_TRIALS);
    let identified = identify(&solution, &sources, outputs::build_outputs(&model, &groups), Some(trials))?;
    let mut estimate = identified.estimate(super::NAME);
    // The deviations come first: those of N1 and of the best variant, then those of the other variants.
    estimate.parameters.rotate_right(2 * variants.len());
    sort_deviations(&mut estimate.parameters[..2 * variants.len()], [&variants[0], best]);
    estimate.arrows = outputs::deviation_arrows(&setup, &observed, &points, [&variants[0], best]);
    estimate.functions.extend(variants.iter().map(outputs::deviation_histogram));
    Ok(Estimate {
        gauge: outputs::describe_gauge(
            tool_ball_id(&setup, tool_ball),
            simulate_noise_mm(&weights, &points.ball_index, u_mm),
        ),
        not_identifiable: lost.into_iter().chain(identified.outlier_check.describe_detection_limits()).collect(),
        warnings: outputs::collect_warnings(&observed, known.is_some(), &identified),
        ..estimate
    })
}

/// Puts the deviations of the `shown` variants first.
fn sort_deviations(parameters: &mut [Parameter], shown: [&DomeVariant; 2]) {
    parameters.sort_by_key(|parameter| {
        let (name, statistic) = parameter.symbol.split_once('_').unwrap_or_default();
        let is_shown = shown.iter().any(|variant| variant.kind.name == name);
        (!is_shown, is_shown && statistic == "mean")
    });
}

/// Each ball at each indexation as a measurement for the outlier check.
fn variant_measurements(observed: &ObservedBalls, judged: &DomeVariant, weights: &[Matrix3<f64>]) -> Vec<Measurement> {
    outlier_measurements(observed, |i| (judged.fit.deviations[i], 3 * i, mean_coordinate_u_mm(&weights[i])))
}

fn variant_index(variants: &[DomeVariant], name: &str) -> Option<usize> {
    variants.iter().position(|variant| variant.kind.name == name)
}

fn check_ball_count(observed: &ObservedBalls) -> Result<(), MethodRefusal> {
    let mut balls: Vec<usize> = observed.centres.iter().map(|centre| centre.ball).collect();
    balls.sort_unstable();
    balls.dedup();
    MethodRefusal::require(
        balls.len() >= 3,
        format!("{} balls are measured: the position of the artefact requires three or more", balls.len()),
        "continue the run, or give all readings of the run",
    )
}

fn tool_ball_index(setup: &MeasurementSetup<'_>, settings: &BallDomeSettings) -> usize {
    let named = setup.balls.balls.iter().position(|ball| ball.id == settings.tool_ball);
    named.unwrap_or_default()
}

fn tool_ball_id<'a>(setup: &MeasurementSetup<'a>, ball: usize) -> &'a str {
    setup.balls.balls.get(ball).map_or("", |ball| &ball.id)
}

fn point_weights(points: &MeasuredPoints, sources: &[UncertaintySource]) -> Vec<Matrix3<f64>> {
    let least = Matrix3::from_diagonal_element(MIN_U_MM.powi(2));
    let covariances = block_covariances::<3>(sources, points.count());
    let weight = |(covariance, into_table): (Matrix3<f64>, &Matrix3<f64>)| {
        let back = into_table.try_inverse().unwrap_or(Matrix3::repeat(f64::NAN));
        whitening_matrix(least + covariance) * back
    };
    covariances.into_iter().zip(&points.into_table).map(weight).collect()
}

/// `is_judged`: whether its residuals are compared with the declared sources.
fn fit_figures(points: &MeasuredPoints, best: &DomeVariant, is_judged: bool) -> Result<FitQuality, IdentifyError> {
    let RankAnalysis { rank, condition, .. } =
        survey_variant(points, best).map_err(|error| IdentifyError::IdentificationFailed(error.to_string()))?;
    let coordinates: Vec<f64> = best.fit.deviations.iter().flatten().copied().collect();
    Ok(FitQuality {
        rank,
        unknowns: UNKNOWN_COUNT,
        condition,
        dof: if is_judged { (3 * points.count()).saturating_sub(UNKNOWN_COUNT) } else { 0 },
        residual_rms_mm: rms(&coordinates),
    })
}

/// Survey of the equations for stylus, translation and rotation.
fn survey_variant(
    points: &MeasuredPoints,
    best: &DomeVariant,
) -> Result<RankAnalysis, estimation::linear::LinearError> {
    let stylus_derivatives = points.stylus_derivatives(&[]);
    let entry = |row: usize, column: usize| {
        let (i, k, j) = (row / 3, row % 3, column % 3);
        match column / 3 {
            0 => stylus_derivatives[i][(k, j)],
            1 => f64::from(u8::from(k == j)),
            _ => best.fit.arms[i].cross_matrix()[(k, j)],
        }
    };
    let design = Mat::from_fn(3 * points.count(), UNKNOWN_COUNT, entry);
    analyse_rank(design.as_ref(), None, RANK_THRESHOLD)
}
