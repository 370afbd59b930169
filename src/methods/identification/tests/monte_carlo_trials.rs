//! Tests of the Monte Carlo propagation.

use estimation::misfit::Misfit;
use estimation::monte_carlo::{TrialCount, TrialStatistics};
use faer::Mat;
use machine::record::estimate::Unit;

use super::propagation::exact_exponential_model;
use super::{MeanModel, assert_near};
use crate::IdentifyError;
use crate::identification::{
    DrawDistribution, IdentificationOutputs, NonlinearFit, ObservationEffect, ObservationModel, ObservationSpanChange,
    OutputParameter, ResidualTreatment, SolvedLinearFit, TrialSettings, UncertaintySource, propagate_by_trials,
};

const TRIAL_COUNT: usize = 200_001;

pub const MISFIT_AS_DECLARED: Misfit = Misfit {
    chi2: 1.0,
    expected_chi2: 1.0,
    effective_dof: 1.0,
    uncertainty_factor: 1.0,
    is_above_bound: false,
    is_below_bound: false,
};

fn trial_settings(trials: usize) -> TrialSettings {
    TrialSettings { seed: 4, trial_count: TrialCount::Fixed(trials) }
}

fn linear_outputs(slopes: &[&[f64]]) -> IdentificationOutputs {
    let output = |slope: &&[f64]| OutputParameter::from_coefficients("x", Unit::Mm, slope.to_vec(), &[]);
    IdentificationOutputs { linear_parameters: slopes.iter().map(output).collect(), ..IdentificationOutputs::default() }
}

fn run_trials(model: &dyn ObservationModel, sources: &[UncertaintySource], slopes: &[&[f64]]) -> TrialStatistics {
    propagate_by_trials(model, sources, &MISFIT_AS_DECLARED, &linear_outputs(slopes), trial_settings(TRIAL_COUNT))
        .unwrap()
}

/// The sum of four quantities.
fn trials_of_sum_of_four(sources: &[UncertaintySource]) -> TrialStatistics {
    let (a, gain) = (Mat::from_fn(4, 1, |_, _| 0.25), Mat::from_fn(1, 4, |_, _| 1.0));
    let fit = SolvedLinearFit { x: &[0.0], design_matrix: &a, sigma: &[1.0; 4], gain: &gain };
    run_trials(&fit, sources, &[&[1.0]])
}

/// JCGM 101, 9.2.2 and 9.2.3: four normal or four rectangular quantities of u = 1 sum to u = 2. The interval
/// of 95.45 % is ±4 for normal quantities; it is shorter for rectangular ones.
#[test]
fn paper_jcgm_101_additive_model() {
    let each = UncertaintySource::new("each", ObservationEffect::Independent(vec![1.0; 4]));
    let normal = trials_of_sum_of_four(std::slice::from_ref(&each));
    let rectangular =
        trials_of_sum_of_four(&[UncertaintySource { draw_distribution: DrawDistribution::Rectangular, ..each }]);
    for found in [&normal, &rectangular] {
        assert_near(found.mean[0], 0.0, 4.0 * 2.0 / (TRIAL_COUNT as f64).sqrt());
        assert_near(found.standard_deviation[0], 2.0, 2.0 * 4.0 / (2.0 * TRIAL_COUNT as f64).sqrt());
    }
    assert_near(normal.symmetric_interval[0][1], 4.0, 0.05);
    // JCGM 101, table 3: [-3.88, 3.88] at 95 %; ±2·√12 is the upper bound.
    assert!((3.88..3.99).contains(&rectangular.symmetric_interval[0][1]), "{:?}", rectangular.symmetric_interval);
}

/// Two unknowns from three rows: their standard deviations and that of their difference, by hand.
#[test]
fn trials_of_linear_fit_agree_with_hand_calculation() {
    let gain = Mat::from_fn(2, 3, |i, j| [[0.5, 0.5, 0.0], [1.0, 0.0, -2.0]][i][j]);
    let a = Mat::zeros(3, 2);
    let fit = SolvedLinearFit { x: &[10.0, -3.0], design_matrix: &a, sigma: &[1.0; 3], gain: &gain };
    let sources = [UncertaintySource::new("each", ObservationEffect::Independent(vec![1.0, 2.0, 0.5]))];
    let found = run_trials(&fit, &sources, &[&[1.0, 0.0], &[0.0, 1.0], &[1.0, -1.0]]);
    let expected = [(10.0, 1.25), (-3.0, 2.0), (13.0, 0.25 + 1.0 + 1.0)];
    assert_eq!((found.trial_count, found.is_stable), (TRIAL_COUNT, true));
    for (j, (mean, variance)) in expected.into_iter().enumerate() {
        let (sd, root) = (f64::sqrt(variance), (TRIAL_COUNT as f64).sqrt());
        assert_near(found.mean[j], mean, 4.0 * sd / root);
        assert_near(found.standard_deviation[j] / sd, 1.0, 4.0 / (2.0_f64.sqrt() * root));
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let single = pool.install(|| run_trials(&fit, &sources, &[&[1.0, 0.0]]));
    assert_eq!(single.mean[0], found.mean[0]);
    assert_eq!(single.standard_deviation[0], found.standard_deviation[0]);
}

/// Sources follow each other in the random stream: the same draws as spans, as columns and as single
/// observations give the same trials.
#[test]
fn effects_of_the_same_draws_give_the_same_trials() {
    let mean = MeanModel::from_readings(&[0.0; 3]);
    let sizes = [0.5, 0.2, 0.7];
    let column = |i: usize, size: f64| [vec![0.0; i], vec![size]].concat();
    let numbered = || sizes.into_iter().enumerate();
    let span_of = |(first, size)| ObservationSpanChange { first_index: first, changes_mm: vec![size] };
    let before = UncertaintySource::new("before", ObservationEffect::Joint(vec![vec![0.3; 3], vec![0.1; 2]]));
    let found = [
        ObservationEffect::Independent(sizes.to_vec()),
        ObservationEffect::Spans(numbered().map(span_of).collect()),
        ObservationEffect::Joint(numbered().map(|(i, size)| column(i, size)).collect()),
    ]
    .map(|effect| {
        run_trials(&mean.solved_linear_fit(), &[before.clone(), UncertaintySource::new("one", effect)], &[&[1.0]])
    });
    let variance = 0.09 + (0.2_f64 / 3.0).powi(2) + (0.25 + 0.04 + 0.49) / 9.0;
    for one in &found {
        let relative = 4.0 / (2.0 * TRIAL_COUNT as f64).sqrt();
        assert_near(one.standard_deviation[0] / variance.sqrt(), 1.0, relative);
        assert_near(one.mean[0], found[0].mean[0], 1e-14);
        assert_near(one.standard_deviation[0], found[0].standard_deviation[0], 1e-14);
    }
}

/// The misfit factor scales only the source that the residuals scale.
#[test]
fn misfit_factor_does_not_scale_expected_sources() {
    let mean = MeanModel::from_readings(&[0.0]);
    let scaled = UncertaintySource::new("judged", ObservationEffect::Independent(vec![1.0]));
    let expected = UncertaintySource { residual_treatment: ResidualTreatment::InExpectedChi2, ..scaled.clone() };
    let misfit = Misfit { uncertainty_factor: 3.0, ..MISFIT_AS_DECLARED };
    for (source, sd) in [(scaled, 3.0), (expected, 1.0)] {
        let outputs = linear_outputs(&[&[1.0]]);
        let found =
            propagate_by_trials(&mean.solved_linear_fit(), &[source], &misfit, &outputs, trial_settings(10_000));
        assert_near(found.unwrap().standard_deviation[0], sd, 0.03 * sd);
    }
}

/// A draw that shifts the unknown by the observations and directly by the opposite amount changes no trial.
#[test]
fn opposite_effects_of_a_draw_cancel_in_trials() {
    let mean = MeanModel::from_readings(&[1.0, 2.0, 3.0]);
    let mut source = UncertaintySource::new("shift", ObservationEffect::Joint(vec![vec![0.4; 3]; 2]));
    source.direct_unknown_changes = vec![vec![-0.4]; 2];
    let noise = UncertaintySource::new("noise", ObservationEffect::Independent(vec![1.0; 3]));
    let found = run_trials(&mean.solved_linear_fit(), std::slice::from_ref(&source), &[&[1.0]]);
    assert_near(found.mean[0], 2.0, 1e-14);
    assert_near(found.standard_deviation[0], 0.0, 1e-14);
    source.effect = ObservationEffect::Independent(vec![0.0; 2]);
    let found = run_trials(&mean.solved_linear_fit(), &[noise, source], &[&[1.0]]);
    let variance = 1.0 / 3.0 + 2.0 * 0.16_f64;
    assert_near(found.standard_deviation[0] / variance.sqrt(), 1.0, 0.007);
}

/// With a nonlinear model the mean of the trials is shifted to second order.
#[test]
fn trials_show_the_second_order_shift_of_the_mean() {
    let equation = exact_exponential_model();
    let minimum = equation.solve_minimum();
    let model = NonlinearFit { equation: &equation, minimum: &minimum };
    let change = [0.02, 0.06, 0.12, 0.2];
    let source = UncertaintySource::new("growth", ObservationEffect::Joint(vec![change.to_vec()]));
    let found = run_trials(&model, &[source], &[&[1.0]]);
    let at = |unit: f64| model.unknowns_for_changed_observations(&change.map(|change| unit * change))[0] - minimum.x[0];
    // Moments of the near solution by Gauss–Hermite quadrature of five points.
    let nodes = [(2.856_970, 0.011_257_4), (1.355_626, 0.222_075_9)];
    let moment = |power: i32| -> f64 {
        let pair = |(node, weight)| weight * (f64::powi(at(node), power) + at(-node).powi(power));
        nodes.into_iter().map(pair).sum()
    };
    let variance = moment(2) - moment(1).powi(2);
    let shift = found.mean[0] - minimum.x[0];
    assert!(moment(1).abs() > 10.0 * variance.sqrt() / (TRIAL_COUNT as f64).sqrt());
    assert_near(shift, moment(1), 4.0 * variance.sqrt() / (TRIAL_COUNT as f64).sqrt());
    assert_near(found.standard_deviation[0] / variance.sqrt(), 1.0, 0.01);
}

#[test]
fn one_trial_is_refused() {
    let mean = MeanModel::from_readings(&[0.0]);
    let found = propagate_by_trials(
        &mean.solved_linear_fit(),
        &[],
        &MISFIT_AS_DECLARED,
        &linear_outputs(&[&[1.0]]),
        trial_settings(1),
    );
    assert!(matches!(found, Err(IdentifyError::IdentificationFailed(reason)) if reason.starts_with("1 trials")));
}
