//! Tests of the first-order propagation.

use estimation::nonlinear_least_squares::{NonlinearSolution, minimise_squares};
use estimation::schur::BlockRows;
use faer::Mat;

use super::{MeanModel, assert_near, solved_model_of_full_rank};
use crate::identification::{
    EvaluationType, NonlinearFit, ObservationEffect, ObservationEquation, ObservationModel, ObservationSpanChange,
    Propagation, ResidualTreatment, UncertaintySource,
};

/// Mean of two readings. Independent 0.3 and 0.4: 0.25·(0.09 + 0.16) = 0.25²; common 0.5: 0.5².
#[test]
fn uncertainty_of_two_sources_agrees_with_hand_calculation() {
    let mean = MeanModel::from_readings(&[1.0, 3.0]);
    let fit = mean.solved_linear_fit();
    let both = UncertaintySource::new("both", ObservationEffect::Joint(vec![vec![0.5, 0.5]]));
    let sources = [UncertaintySource::new("each", ObservationEffect::Independent(vec![0.3, 0.4])), both];
    let propagation = Propagation::new(&mean.solved_model_of_full_rank(&fit, true), &sources);
    // χ² = 2 is above the expectation 0.5·(0.3² + 0.4²) = 0.125, and both sources are scaled by 4.
    assert_near(propagation.misfit.expected_chi2, 0.125, 1e-15);
    assert_near(propagation.misfit.uncertainty_factor, 4.0, 1e-12);
    let found = propagation.output_uncertainty(&[2.0]);
    assert_near(found.u, 2.0 * 4.0 * 0.3125_f64.sqrt(), 1e-12);
    let lines: Vec<(&str, f64)> = found.budget.iter().map(|line| (line.source.as_str(), line.u)).collect();
    assert_eq!((lines[0].0, lines[1].0), ("each", "both"));
    assert_near(lines[0].1, 2.0, 1e-12);
    assert_near(lines[1].1, 4.0, 1e-12);
    let slopes = Mat::from_fn(2, 1, |i, _| [2.0, -1.0][i]);
    assert_near(propagation.output_covariance(&slopes)[(0, 1)], -2.0 * 16.0 * 0.3125, 1e-11);
}

/// JCGM 100, 4.2.3: without a declaration the mean of n readings has u = s/√n and n − 1 degrees of freedom. A
/// certificate of u = 3 with 8 degrees of freedom is combined with it by equation G.2b.
#[test]
fn paper_gum_mean_of_repeated_readings() {
    let mean = MeanModel::from_readings(&[-5.0, -3.0, -1.0, 1.0, 3.0, 5.0]);
    let fit = mean.solved_linear_fit();
    let repeatability = UncertaintySource {
        evaluation: EvaluationType::A,
        ..UncertaintySource::new("repeatability", ObservationEffect::Independent(vec![1.0; 6]))
    };
    let certificate = UncertaintySource {
        dof: 8.0,
        residual_treatment: ResidualTreatment::ExcludedFromChi2,
        ..UncertaintySource::new("certificate", ObservationEffect::Joint(vec![vec![3.0; 6]]))
    };
    let sources = [repeatability, certificate];
    let alone =
        Propagation::new(&mean.solved_model_of_full_rank(&fit, false), &sources[..1]).output_uncertainty(&[1.0]);
    let variance = 14.0 / 6.0;
    assert_near(alone.u, f64::sqrt(variance), 1e-12);
    assert_near(alone.dof.unwrap(), 5.0, 1e-9);
    // Student's t for 95.45 % and 5 degrees of freedom (JCGM 100, table G.2).
    assert_near(alone.expanded() / alone.u, 2.65, 0.0051);
    let both = Propagation::new(&mean.solved_model_of_full_rank(&fit, false), &sources).output_uncertainty(&[1.0]);
    let combined = variance + 9.0;
    assert_near(both.u, combined.sqrt(), 1e-12);
    let dof = combined.powi(2) / (variance.powi(2) / 5.0 + 81.0 / 8.0);
    assert_near(both.dof.unwrap(), dof, 1e-9);
}

/// Sizes that the residuals do not scale have infinitely many degrees of freedom, and k = 2.
#[test]
fn declared_sizes_are_kept_if_residuals_agree() {
    let mean = MeanModel::from_readings(&[0.5, -0.5, 1.0, -1.0]);
    let fit = mean.solved_linear_fit();
    let sources = [UncertaintySource::new("each", ObservationEffect::Independent(vec![1.0; 4]))];
    let found = Propagation::new(&mean.solved_model_of_full_rank(&fit, true), &sources).output_uncertainty(&[1.0]);
    assert_eq!((found.u, found.dof, found.expanded()), (0.5, None, 1.0));
    // With as many unknowns as rows the residuals scale nothing, not even undeclared sizes.
    let single = MeanModel::from_readings(&[7.0]);
    let fit = single.solved_linear_fit();
    let sources = [UncertaintySource::new("each", ObservationEffect::Independent(vec![1.0]))];
    let found = Propagation::new(&single.solved_model_of_full_rank(&fit, false), &sources).output_uncertainty(&[1.0]);
    assert_eq!((found.u, found.dof), (1.0, None));
}

/// The same draws as spans and as columns, absent from χ² or expected in it.
#[test]
fn spans_and_columns_of_the_same_draws_agree() {
    let mean = MeanModel::from_readings(&[0.1, 0.0, -0.1]);
    let fit = mean.solved_linear_fit();
    let span = |first, values: &[f64]| ObservationSpanChange { first_index: first, changes_mm: values.to_vec() };
    let spans = ObservationEffect::Spans(vec![span(0, &[0.5]), span(1, &[0.2, -0.7])]);
    let columns = ObservationEffect::Joint(vec![vec![0.5], vec![0.0, 0.2, -0.7]]);
    let propagated = |effect: ObservationEffect, in_residuals: ResidualTreatment| {
        let source = UncertaintySource { residual_treatment: in_residuals, ..UncertaintySource::new("one", effect) };
        Propagation::new(&mean.solved_model_of_full_rank(&fit, true), &[source])
    };
    let [a, b] = [spans.clone(), columns].map(|effect| propagated(effect, ResidualTreatment::InExpectedChi2));
    assert_eq!(a.output_uncertainty(&[1.0]).u, b.output_uncertainty(&[1.0]).u);
    assert_eq!(a.misfit.expected_chi2, b.misfit.expected_chi2);
    assert_near(a.output_uncertainty(&[1.0]).u, (0.25_f64 + 0.25).sqrt() / 3.0, 1e-15);
    assert_eq!(propagated(spans, ResidualTreatment::ExcludedFromChi2).misfit.expected_chi2, 0.0);
}

/// y_i = exp(x·t_i), a nonlinear model of one unknown with standard uncertainty `SIGMA`.
pub struct ExponentialModel {
    pub readings: Vec<f64>,
}

const TIMES: [f64; 4] = [0.5, 1.0, 1.5, 2.0];
const SIGMA: f64 = 0.01;

impl ExponentialModel {
    pub fn solve_minimum(&self) -> NonlinearSolution {
        let rows = |x: &[f64]| {
            let mut rows = BlockRows::zeros(TIMES.len(), 0, 1);
            for (i, t) in TIMES.into_iter().enumerate() {
                rows.set_common_coefficient(i, 0, t * (x[0] * t).exp() / SIGMA);
                rows.set_right_side(i, (self.readings[i] - (x[0] * t).exp()) / SIGMA);
            }
            vec![rows]
        };
        minimise_squares(vec![0.2], rows, |x| self.weighted_residuals(x, &[0.0; 4])).unwrap()
    }
}

impl ObservationEquation for ExponentialModel {
    fn observation_count(&self) -> usize {
        TIMES.len()
    }

    fn weighted_residuals(&self, x: &[f64], change: &[f64]) -> Vec<f64> {
        let rows = self.readings.iter().zip(change).zip(TIMES);
        rows.map(|((y, change), t)| (y + change - (x[0] * t).exp()) / SIGMA).collect()
    }

    fn weighted_residual_change(&self, change: &[f64]) -> Vec<f64> {
        change.iter().map(|change| change / SIGMA).collect()
    }
}

/// Exact readings of the model for x = 0.3.
pub fn exact_exponential_model() -> ExponentialModel {
    ExponentialModel { readings: TIMES.map(|t| (0.3 * t).exp()).to_vec() }
}

/// The response equals the derivative of full solutions of changed readings, including the sign.
#[test]
fn response_is_the_derivative_of_the_solution() {
    let equation = exact_exponential_model();
    let minimum = equation.solve_minimum();
    let model = NonlinearFit { equation: &equation, minimum: &minimum };
    let change = [1e-5, -2e-5, 3e-5, 2e-5];
    let solved = |sign: f64| {
        let readings = equation.readings.iter().zip(change).map(|(y, by)| y + sign * by);
        ExponentialModel { readings: readings.collect() }.solve_minimum()
    };
    let (up, down) = (solved(1.0), solved(-1.0));
    let response = model.linear_response(&change);
    assert_near(response.unknown_changes[0], 0.5 * (up.x[0] - down.x[0]), 1e-9);
    assert!(response.unknown_changes[0] > 5e-6);
    for (i, found) in response.residual_changes.iter().enumerate() {
        assert_near(*found, 0.5 * (up.residuals[i] - down.residuals[i]), 1e-7);
    }
}

/// Readings for an unknown that is larger by a step: the error of the near solution is of third order.
#[test]
fn near_solution_is_right_to_second_order() {
    let equation = exact_exponential_model();
    let minimum = equation.solve_minimum();
    let model = NonlinearFit { equation: &equation, minimum: &minimum };
    let error = |step: f64| {
        let change = TIMES.map(|t| ((0.3 + step) * t).exp() - (0.3 * t).exp());
        (model.unknowns_for_changed_observations(&change)[0] - 0.3 - step).abs()
    };
    let ratio = error(0.02) / error(0.01);
    assert!((7.0..9.0).contains(&ratio), "{ratio}");
    assert!(error(0.01) < 1e-5);
}

/// A draw that shifts the unknown by the observations and directly by the opposite amount has no effect: a
/// change of the observations has the sign of measured minus model in dense and in blockwise fits.
#[test]
fn opposite_effects_of_a_draw_cancel() {
    let mean = MeanModel::from_readings(&[0.1, 0.2, 0.3]);
    let fit = mean.solved_linear_fit();
    let source = UncertaintySource {
        residual_treatment: ResidualTreatment::ExcludedFromChi2,
        direct_unknown_changes: vec![vec![-0.4]],
        ..UncertaintySource::new("shift", ObservationEffect::Joint(vec![vec![0.4; 3]]))
    };
    let found = Propagation::new(&mean.solved_model_of_full_rank(&fit, true), &[source]);
    assert_near(found.output_uncertainty(&[1.0]).u, 0.0, 1e-15);

    let equation = exact_exponential_model();
    let minimum = equation.solve_minimum();
    let model = NonlinearFit { equation: &equation, minimum: &minimum };
    let shift: Vec<f64> = TIMES.iter().map(|t| 0.01 * t * (minimum.x[0] * t).exp()).collect();
    assert_eq!((model.observation_count(), model.unknown_count()), (4, 1));
    let mut source = UncertaintySource {
        residual_treatment: ResidualTreatment::ExcludedFromChi2,
        ..UncertaintySource::new("shift", ObservationEffect::Joint(vec![shift]))
    };
    let alone = solved_model_of_full_rank(&model, &minimum.residuals, true);
    let found = Propagation::new(&alone, std::slice::from_ref(&source));
    assert_near(found.output_uncertainty(&[1.0]).u, 0.01, 1e-8);
    source.direct_unknown_changes = vec![vec![-0.01]];
    let found = Propagation::new(&alone, &[source]);
    assert_near(found.output_uncertainty(&[1.0]).u, 0.0, 1e-8);
}
