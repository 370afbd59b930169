//! Tests of the estimates that identifications produce.

use std::f64::consts::PI;

use estimation::monte_carlo::TrialCount;
use faer::{Mat, MatRef};
use machine::kinematics::ErrorParameter;
use machine::record::estimate::{FunctionFigureKind, Unit};

use super::{MeanModel, assert_near};
use crate::identification::{
    IdentificationOutputs, NonlinearOutputs, ObservationEffect, OutputCurve, OutputParameter, TrialSettings,
    UncertaintySource, central_differences, identify, parameter_without_budget, reported_unit,
};

#[test]
fn source_of_wrong_length_is_refused_with_its_name() {
    let mean = MeanModel::from_readings(&[2e-3, -2e-3, 1e-3, -1e-3]);
    let fit = mean.solved_linear_fit();
    let each = |count| UncertaintySource::new("scatter", ObservationEffect::Independent(vec![1e-3; count]));
    let direct = |rows: Vec<Vec<f64>>| UncertaintySource { direct_unknown_changes: rows, ..each(4) };
    let long = UncertaintySource::new("scatter", ObservationEffect::Joint(vec![vec![1e-3; 5]]));
    let one = || vec![1.0];
    let wrong = [each(5), long, direct(vec![one()]), direct(vec![vec![1.0, 2.0]; 4])];
    for source in wrong {
        let plan = TrialSettings { seed: 1, trial_count: TrialCount::Fixed(100) };
        let solution = mean.solved_model_of_full_rank(&fit, true);
        let refused = identify(&solution, &[source], IdentificationOutputs::default(), Some(plan));
        let reason = refused.err().map(|error| error.to_string()).unwrap_or_default();
        assert!(reason.contains("`scatter` does not match 4 observations and 1 unknowns"), "{reason}");
    }
    let solution = mean.solved_model_of_full_rank(&fit, true);
    assert!(identify(&solution, &[direct(vec![one(); 4])], IdentificationOutputs::default(), None).is_ok());
}

/// |x| of an x around zero has a half-normal distribution.
fn magnitude_output() -> NonlinearOutputs {
    let values = |x: MatRef<'_, f64>| Mat::from_fn(x.nrows(), 1, |trial, _| x[(trial, 0)].abs());
    let output = OutputParameter { symbol: "size".into(), unit: Unit::Um, value: 0.0, linear_slope: None };
    NonlinearOutputs { outputs: vec![output], trial_values: Box::new(values) }
}

/// A mean of four readings of u = 2 µm has u = 1 µm, also as an angle over 500 mm. The magnitude of
/// such a mean has the standard deviation √(1 − 2/π).
#[test]
fn estimate_agrees_with_hand_calculation() {
    let mean = MeanModel::from_readings(&[2e-3, -2e-3, 1e-3, -1e-3]);
    let fit = mean.solved_linear_fit();
    let x = [4e-3];
    let outputs = IdentificationOutputs {
        linear_parameters: vec![
            OutputParameter::from_unknown("EX0C", Unit::Um, 0, &x),
            OutputParameter::from_coefficients("EB0C", Unit::Urad, vec![0.002], &x),
        ],
        curves: vec![OutputCurve {
            symbol: "E".into(),
            argument: "C",
            argument_unit: "deg",
            x: vec![0.0, 90.0],
            y: vec![4e-3, -8e-3],
            unit: Unit::Um,
            figure: FunctionFigureKind::Polar,
            slopes: vec![vec![1.0], vec![-2.0]],
        }],
        nonlinear: Some(magnitude_output()),
    };
    let sources = [UncertaintySource::new("each", ObservationEffect::Independent(vec![2e-3; 4]))];
    let plan = TrialSettings { seed: 1, trial_count: TrialCount::Fixed(100_000) };
    let identified = identify(&mean.solved_model_of_full_rank(&fit, true), &sources, outputs, Some(plan)).unwrap();
    assert!(identified.symbols_contradicted_by_trials().is_empty());
    let estimate = identified.estimate("mean");
    let [location, angle, size] = estimate.parameters.as_slice() else { panic!() };
    for (found, expected) in [(location.value, 4.0), (location.u, 1.0), (location.expanded, 2.0)] {
        assert_near(found, expected, 1e-9);
    }
    assert_eq!((location.k, location.dof, location.budget[0].source.as_str()), (2.0, None, "each"));
    assert_near(location.budget[0].u, 1.0, 1e-9);
    assert_near(angle.value, 8.0, 1e-9);
    assert_near(angle.u, 2.0, 1e-9);
    assert_near(angle.u_monte_carlo.unwrap(), 2.0, 0.02);
    assert_near(size.u, (1.0 - 2.0 / PI).sqrt(), 0.01);
    assert_eq!((size.u_monte_carlo, size.budget.len()), (Some(size.u), 0));
    assert_eq!(estimate.covariance.symbols, ["EX0C", "EB0C"]);
    assert_near(estimate.covariance.rows[0][1], 2.0, 1e-9);
    assert_near(estimate.covariance.rows[1][1], 4.0, 1e-9);
    assert_eq!(estimate.functions[0].y, [4.0, -8.0]);
    assert_near(estimate.functions[0].u[1], 2.0, 1e-9);
    // χ² is 10 with weights of 1; the expectation is 3·4, both in µm².
    assert_near(estimate.chi2_per_dof, 10.0 / 12.0, 1e-9);
    assert_eq!((estimate.degrees_of_freedom, estimate.rank), (3, 1));
    assert_near(identified.parameter_uncertainty(1).unwrap().u, 2e-6, 1e-15);
    assert!(identified.parameter_uncertainty(3).is_none());
}

/// A nonlinear output alone, such as a largest deviation, has no uncertainty without trials.
#[test]
fn nonlinear_output_without_trials_has_no_uncertainty() {
    let mean = MeanModel::from_readings(&[0.0, 0.0]);
    let fit = mean.solved_linear_fit();
    let sources = [UncertaintySource::new("each", ObservationEffect::Independent(vec![1e-3; 2]))];
    let outputs = IdentificationOutputs { nonlinear: Some(magnitude_output()), ..IdentificationOutputs::default() };
    let identified = identify(&mean.solved_model_of_full_rank(&fit, true), &sources, outputs, None).unwrap();
    let estimate = identified.estimate("mean");
    assert!(estimate.parameters[0].u.is_nan() && estimate.covariance.rows.is_empty());
    assert!(identified.symbols_contradicted_by_trials().is_empty());
}

/// A stated u that is ten times too small.
#[test]
fn trials_contradict_a_wrong_slope() {
    let mean = MeanModel::from_readings(&[0.0]);
    let fit = mean.solved_linear_fit();
    let sources = [UncertaintySource::new("each", ObservationEffect::Independent(vec![1.0]))];
    let outputs = IdentificationOutputs {
        linear_parameters: vec![OutputParameter::from_unknown("x", Unit::Mm, 0, &[0.0])],
        ..IdentificationOutputs::default()
    };
    let plan = TrialSettings { seed: 1, trial_count: TrialCount::Fixed(10_000) };
    let mut identified = identify(&mean.solved_model_of_full_rank(&fit, true), &sources, outputs, Some(plan)).unwrap();
    assert!(identified.symbols_contradicted_by_trials().is_empty());
    identified.outputs.linear_parameters[0].linear_slope = Some(vec![0.1]);
    assert_eq!(identified.symbols_contradicted_by_trials(), ["x"]);
}

/// Test with GUM table G.2: k = 2.65 for 5 degrees of freedom.
#[test]
fn paper_gum_parameter_has_the_expanded_u_of_table_g2() {
    let parameter = parameter_without_budget("T_scan", Unit::Ms, 2e-3, 1e-4, Some(5.0));
    assert_near(parameter.value, 2.0, 1e-12);
    assert_near(parameter.expanded, 0.265, 6e-4);
    assert_eq!(parameter_without_budget("a", Unit::Mm, 0.0, 1.0, None).k, 2.0);
}

/// Derivatives of the functions x² + y and x·y at (3, 5).
#[test]
fn central_differences_of_polynomials_are_exact() {
    let function = |x: &[f64]| Some(vec![x[0] * x[0] + x[1], x[0] * x[1]]);
    let slopes = central_differences(&[3.0, 5.0], 1e-3, function).unwrap();
    for (found, expected) in slopes.iter().flatten().zip([6.0, 1.0, 5.0, 3.0]) {
        assert_near(*found, expected, 1e-9);
    }
    let until_three = |x: &[f64]| (x[0] <= 3.0).then(|| x.to_vec());
    assert_eq!(central_differences(&[3.0], 1e-3, until_three), None);
}

#[test]
fn error_parameters_have_their_units() {
    for (symbol, unit) in [("EX0C", Unit::Um), ("EA0C", Unit::Urad), ("EXX1", Unit::UmPerM)] {
        let error: ErrorParameter = symbol.parse().unwrap();
        assert_eq!(reported_unit(&error), unit, "{symbol}");
    }
}
