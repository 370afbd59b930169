//! Tests of the outlier detection.

use super::{MeanModel, assert_near};
use crate::identification::outliers::{OutlierCheck, ResidualStatistics, are_indistinguishable};
use crate::identification::{
    IdentificationOutputs, MeasurementToCheck, ObservationEffect, SolvedModel, UncertaintySource, identify,
};

/// Compares readings of one quantity, mm; each is a measurement of 1 mm standard uncertainty.
fn check_readings(readings: &[f64], has_declared_sizes: bool, rows: usize) -> OutlierCheck {
    let mean = MeanModel::from_readings(readings);
    let fit = mean.solved_linear_fit();
    let measurement = |i: usize| MeasurementToCheck {
        label: i.to_string(),
        description: format!("reading {i}"),
        residual_rows: rows * i..rows * (i + 1),
        residual_mm: mean.residuals[rows * i],
        u_mm: 1.0,
        mean_time_s: 0.0,
    };
    let measurements: Vec<MeasurementToCheck> = (0..readings.len() / rows).map(measurement).collect();
    let solution =
        SolvedModel { measurements: &measurements, ..mean.solved_model_of_full_rank(&fit, has_declared_sizes) };
    let source = UncertaintySource::new("each", ObservationEffect::Independent(vec![1.0; readings.len()]));
    identify(&solution, &[source], IdentificationOutputs::default(), None).unwrap().outlier_check
}

/// Label and studentised residual of each outlier.
fn find_outliers(readings: &[f64], has_declared_sizes: bool, rows: usize) -> Vec<(String, f64)> {
    let outliers = check_readings(readings, has_declared_sizes, rows).outliers.into_iter();
    outliers.map(|outlier| (outlier.candidates[0].label.clone(), outlier.studentised_residual)).collect()
}

const READINGS_WITH_OUTLIER: [f64; 8] = [10.2, 9.7, 10.1, 9.9, 10.4, 9.8, 10.0, 14.0];

/// Mean, scatter and prediction are computed without the suspect reading.
#[test]
fn a_reading_is_compared_with_all_others() {
    let others = &READINGS_WITH_OUTLIER[..7];
    let without = others.iter().sum::<f64>() / 7.0;
    let variance = others.iter().map(|own| (own - without).powi(2)).sum::<f64>() / 6.0;
    let expected = (14.0 - without) / (variance * (1.0 + 1.0 / 7.0)).sqrt();
    let found = find_outliers(&READINGS_WITH_OUTLIER, false, 1);
    let [(label, t)] = &found[..] else { panic!("{found:?}") };
    assert_eq!(label, "7");
    assert_near(*t, expected, 1e-9);
    // The others scatter less than declared, and a deviation of 4 is not significant for a standard
    // uncertainty of 1.
    assert!(find_outliers(&READINGS_WITH_OUTLIER, true, 1).is_empty());
    let pairs = find_outliers(&READINGS_WITH_OUTLIER, false, 2);
    assert_eq!((pairs.len(), &*pairs[0].0), (1, "3"));
}

/// The model is the mean, 10.5125 mm.
#[test]
fn residual_is_reading_minus_model() {
    let checks = check_readings(&READINGS_WITH_OUTLIER, false, 1).measurement_checks;
    let expected = [-312.5, -812.5, -412.5, -612.5, -112.5, -712.5, -512.5, 3487.5];
    assert_eq!(checks.len(), expected.len());
    for (check, expected_um) in checks.iter().zip(expected) {
        assert_near(check.residual_um.unwrap(), expected_um, 1e-6);
    }
}

/// Limits from tables of Student's t (ν = 19) and of F (3 and 20 degrees of freedom) at 0.1 %.
#[test]
fn studentised_limits_agree_with_tables() {
    let rows = ResidualStatistics {
        weighted_residuals: &[0.0; 3],
        residual_variances: &[1.0; 3],
        scaled_chi2: 20.0,
        effective_dof: 20.0,
        has_declared_source_sizes: true,
    };
    assert_near(rows.studentised_limit(0..1, 1e-3).unwrap(), 3.883, 5e-4);
    let three = ResidualStatistics { effective_dof: 23.0, ..rows };
    assert_near(three.studentised_limit(0..3, 1e-3).unwrap().powi(2) / 3.0, 8.10, 5e-3);
}

/// A row that explains only itself is not checked; without degrees of freedom no row is checked.
#[test]
fn row_without_redundancy_is_not_checked() {
    let rows = |dof| ResidualStatistics {
        weighted_residuals: &[0.1, -0.2, 0.1, 1e6],
        residual_variances: &[0.6, 0.6, 0.6, 0.0],
        scaled_chi2: 0.1,
        effective_dof: dof,
        has_declared_source_sizes: false,
    };
    assert!(rows(20.0).studentised_limit(0..1, 1e-3).is_some() && rows(1.5).studentised_limit(0..1, 1e-3).is_none());
    assert!(rows(20.0).studentised_limit(3..4, 1e-3).is_none());
    assert_eq!(rows(20.0).studentised_residual(3..4), 0.0);
    // Of the three rows of a point only the two that are checked count.
    assert_eq!(rows(20.0).studentised_limit(1..4, 1e-3), rows(20.0).studentised_limit(0..2, 1e-3));
}

#[test]
fn parallel_patterns_are_indistinguishable() {
    let pattern = [0.5, -0.25, 0.1];
    assert!(are_indistinguishable([&pattern, &pattern.map(|p| -3.0 * p)]));
    assert!(!are_indistinguishable([&pattern, &[0.5, -0.25, 0.2]]));
}
