//! Identification: from plan and readings to the estimate.

use estimation::linear::{RANK_THRESHOLD, Survey, survey};
use estimation::monte_carlo::Trials;
use estimation::whitening::whitening;
use faer::Mat;
use nalgebra::{Matrix3, Vector3};

use super::found::{by_errors, variants};
use super::model::DomeModel;
use super::noise::noise_alone;
use super::points::Points;
use super::prior::known_machine;
use super::settings::Settings;
use super::variant::Variant;
use super::{design, outputs, sources};
use crate::ball_measurement::{MeasurementSetup, Observed, measurements, observe};
use crate::identification::{
    FitFigures, Measurement, Solution, TrialPlan, UncertaintySource, block_covariances, identify,
    mean_u_mm, rms,
};
use crate::{IdentifyError, Refused};
use machine::kinematics::Chain;
use machine::record::estimate::Estimate;
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
const UNKNOWNS: usize = 9;

/// # Errors
/// The readings do not belong to the plan, or are too few for the artefact.
pub fn estimate(
    plan: &Plan,
    settings: &Settings,
    readings: &[Reading],
) -> Result<Estimate, IdentifyError> {
    let setup = design::setup(plan, settings)?;
    let known = known_machine(plan)?;
    let observed = observe(plan, readings)?;
    check_count(&observed)?;
    let chain = Chain::new(&plan.machine).map_err(Refused::from)?;
    let stylus = Vector3::from(plan.machine.tool_mm);
    let points = Points::new(chain, stylus, &observed, setup.balls);
    let tool_ball = tool_ball(&setup, settings);
    let (variants, lost) = variants(&points, known.as_ref(), tool_ball);
    let of_readings = sources::of_readings(plan, points.chain(), &observed);
    let judged = known.as_ref().and_then(|_| variants.iter().position(|v| v.kind.name == "S3"));
    let weights = weights(&points, &of_readings);
    let groups = outputs::Groups::of(&observed);
    let model = DomeModel {
        points: &points,
        variants: &variants,
        by_errors: &by_errors(&points, known.as_ref()),
        balls: setup.balls.balls.len(),
        judged,
        groups: &groups.points,
        weights: &weights,
    };
    let mut sources = of_readings;
    let u_mm = setup.balls.certificate_u_mm.unwrap_or_default();
    sources.push(sources::certificate(&model, u_mm));
    sources.push(sources::temperature(&model, setup.balls));
    sources.retain(|source| !source.is_zero());
    sources.extend(known.as_ref().and_then(|known| sources::prior(&model, known)));
    let best = &variants[judged.or_else(|| place(&variants, "N3")).unwrap_or(0)];
    let compared = judged.map_or(Vec::new(), |i| compared(&observed, &variants[i], &weights));
    let solution = Solution {
        model: &model,
        residuals: &judged.map_or(Vec::new(), |i| model.weighted(&variants[i].fit.deviations)),
        is_declared: plan.probe.repeatability_um.is_some(),
        figures: figures(&points, best, judged.is_some())?,
        measurements: &compared,
    };
    let trials = Trials::asked(settings.monte_carlo_trials, STABLE_DIGITS, MAX_TRIALS);
    let trials = TrialPlan { seed: MONTE_CARLO_SEED, trials };
    let identified =
        identify(&solution, &sources, outputs::outputs(&model, &groups), Some(trials))?;
    let mut estimate = identified.estimate(super::NAME);
    // The deviations come first: those of N1 and of the best variant, then those of the other variants.
    estimate.parameters.rotate_right(2 * variants.len());
    let shown = [variants[0].kind.name, best.kind.name];
    estimate.parameters[..2 * variants.len()].sort_by_key(|parameter| {
        let (name, of) = parameter.symbol.split_once('_').unwrap_or_default();
        let is_shown = shown.contains(&name);
        (!is_shown, is_shown && of == "mean")
    });
    estimate.arrows = outputs::arrows(&setup, &observed, &points, [&variants[0], best]);
    estimate.functions.extend(variants.iter().map(outputs::histogram));
    Ok(Estimate {
        gauge: outputs::gauge(
            tool_ball_id(&setup, tool_ball),
            noise_alone(&weights, &points.ball, u_mm),
        ),
        not_identifiable: lost.into_iter().chain(identified.checked.limits()).collect(),
        warnings: outputs::warnings(&observed, known.is_some(), &identified),
        ..estimate
    })
}

/// Each ball at each indexation as a measurement for the outlier check.
fn compared(observed: &Observed, judged: &Variant, weights: &[Matrix3<f64>]) -> Vec<Measurement> {
    measurements(observed, |i| (judged.fit.deviations[i], 3 * i, mean_u_mm(&weights[i])))
}

fn place(variants: &[Variant], name: &str) -> Option<usize> {
    variants.iter().position(|variant| variant.kind.name == name)
}

fn check_count(observed: &Observed) -> Result<(), Refused> {
    let mut balls: Vec<usize> = observed.centres.iter().map(|centre| centre.ball).collect();
    balls.sort_unstable();
    balls.dedup();
    Refused::unless(
        balls.len() >= 3,
        format!("{} balls are measured: three or more show how the artefact stands", balls.len()),
        "go on with the run, or give all of its readings",
    )
}

fn tool_ball(setup: &MeasurementSetup<'_>, settings: &Settings) -> usize {
    let named = setup.balls.balls.iter().position(|ball| ball.id == settings.tool_ball);
    named.unwrap_or_default()
}

fn tool_ball_id<'a>(setup: &MeasurementSetup<'a>, ball: usize) -> &'a str {
    setup.balls.balls.get(ball).map_or("", |ball| &ball.id)
}

fn weights(points: &Points, sources: &[UncertaintySource]) -> Vec<Matrix3<f64>> {
    let least = Matrix3::from_diagonal_element(MIN_U_MM.powi(2));
    let covariances = block_covariances::<3>(sources, points.count());
    let weight = |(covariance, into_table): (Matrix3<f64>, &Matrix3<f64>)| {
        let back = into_table.try_inverse().unwrap_or(Matrix3::repeat(f64::NAN));
        whitening(least + covariance) * back
    };
    covariances.into_iter().zip(&points.into_table).map(weight).collect()
}

/// `is_judged`: whether its residuals are compared with the declared sources.
fn figures(points: &Points, best: &Variant, is_judged: bool) -> Result<FitFigures, IdentifyError> {
    let Survey { rank, condition, .. } =
        survey_of(points, best).map_err(|error| IdentifyError::Numerical(error.to_string()))?;
    let coordinates: Vec<f64> = best.fit.deviations.iter().flatten().copied().collect();
    Ok(FitFigures {
        rank,
        unknowns: UNKNOWNS,
        condition,
        dof: if is_judged { (3 * points.count()).saturating_sub(UNKNOWNS) } else { 0 },
        residual_rms_mm: rms(&coordinates),
    })
}

/// Survey of the equations for stylus, translation and rotation.
fn survey_of(points: &Points, best: &Variant) -> Result<Survey, estimation::linear::LinearError> {
    let by_stylus = points.by_stylus(&[]);
    let entry = |row: usize, column: usize| {
        let (i, k, j) = (row / 3, row % 3, column % 3);
        match column / 3 {
            0 => by_stylus[i][(k, j)],
            1 => f64::from(u8::from(k == j)),
            _ => best.fit.arms[i].cross_matrix()[(k, j)],
        }
    };
    let design = Mat::from_fn(3 * points.count(), UNKNOWNS, entry);
    survey(design.as_ref(), None, RANK_THRESHOLD)
}
