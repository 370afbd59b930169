//! Far measurements.

use super::assert_near;
use crate::identification::{FarMeasurement, RowResiduals, are_alike};

/// Readings of one quantity, one of them far off. Mean, scatter and prediction without that one are made by leaving
/// it out.
#[test]
fn a_reading_is_compared_with_all_others() {
    let readings = [10.2, 9.7, 10.1, 9.9, 10.4, 9.8, 10.0, 14.0];
    let count = readings.len() as f64;
    let mean = readings.iter().sum::<f64>() / count;
    let residuals = readings.map(|reading| reading - mean);
    let declared = |is_declared, rows| RowResiduals {
        residuals: &residuals,
        leverage: &[1.0 / 8.0; 8],
        dof: 7,
        is_declared,
        rows,
    };
    let rows = |rows| declared(false, rows);
    let others = &readings[..7];
    let without = others.iter().sum::<f64>() / 7.0;
    let variance = others.iter().map(|own| (own - without).powi(2)).sum::<f64>() / 6.0;
    let expected = (14.0 - without) / (variance * (1.0 + 1.0 / 7.0)).sqrt();
    let far = rows((0..8).map(|i| i..i + 1).collect()).far_measurements();
    let [FarMeasurement { number: 7, t }] = far[..] else { panic!("{far:?}") };
    assert_near(t, expected, 1e-12);
    // The others scatter less than declared, and 4 is not far beside 1.
    assert!(declared(true, (0..8).map(|i| i..i + 1).collect()).far_measurements().is_empty());
    // The largest of the rows of a measurement counts.
    let pairs = rows((0..4).map(|i| 2 * i..2 * i + 2).collect()).far_measurements();
    assert_eq!(pairs, [FarMeasurement { number: 3, t }]);
}

/// A row that is explained by itself is not checked, and without degrees of freedom nothing is.
#[test]
fn what_no_other_row_checks_is_not_judged() {
    let residuals = [0.1, -0.2, 0.1, 1e6];
    let rows = |dof| RowResiduals {
        residuals: &residuals,
        leverage: &[0.4, 0.4, 0.4, 1.0],
        dof,
        is_declared: false,
        rows: (0..4).map(|i| i..i + 1).collect(),
    };
    assert!(rows(2).far_measurements().is_empty() && rows(1).far_measurements().is_empty());
    assert!(rows(20).smallest_found(0).is_finite());
    assert!(rows(20).smallest_found(3).is_infinite() && rows(1).smallest_found(0).is_infinite());
}

#[test]
fn parallel_patterns_are_alike_whatever_their_sense_and_size() {
    let pattern = [0.5, -0.25, 0.1];
    assert!(are_alike([&pattern, &pattern.map(|p| -3.0 * p)]));
    assert!(!are_alike([&pattern, &[0.5, -0.25, 0.2]]));
}
