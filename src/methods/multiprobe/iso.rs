//! Values of error motions as ISO 230-7 names them: synchronous, fundamental, residual synchronous from
//! the harmonics; total and asynchronous from the single revolutions.

use faer::{Mat, MatRef};

use super::model::Component;
use super::outputs::{ReportedMotions, unit};
use crate::identification::{NonlinearOutputs, Output};

/// Angles at which the largest and the least value of a motion are sought.
const ANGLES: usize = 360;

/// Largest less least value of a linear function of the unknowns over one revolution.
struct Range {
    symbol: String,
    component: Component,
    /// Angles × unknowns.
    slopes: Mat<f64>,
}

impl Range {
    fn new(
        motions: &ReportedMotions<'_>,
        symbol: String,
        component: Component,
        orders: &[usize],
    ) -> Self {
        let angle = |i: usize| i as f64 / ANGLES as f64 * std::f64::consts::TAU;
        let rows: Vec<Vec<f64>> =
            (0..ANGLES).map(|i| motions.slope_at(component, orders, angle(i))).collect();
        let slopes = Mat::from_fn(ANGLES, rows[0].len(), |i, j| rows[i][j]);
        Self { symbol, component, slopes }
    }

    /// One value a trial of `unknowns` (trials × unknowns).
    fn values(&self, unknowns: MatRef<'_, f64>) -> Vec<f64> {
        let curves = &self.slopes * unknowns.transpose();
        (0..curves.ncols()).map(|trial| range(curves.col_as_slice(trial))).collect()
    }
}

/// Largest less least value.
pub fn range(values: &[f64]) -> f64 {
    let largest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    largest - least
}

/// Synchronous error motion values in the fixed sensitive direction of each motion, fundamental (axial
/// alone: the first harmonic of the others is eccentricity or tilt) and residual synchronous axial
/// values; roundness (peak to valley about the least-squares circle). Only identifiable harmonics take
/// part; a motion without one has no value.
pub fn nonlinear_outputs(
    motions: &ReportedMotions<'_>,
    components: &[Component],
) -> NonlinearOutputs {
    let mut ranges = Vec::new();
    for component in components.iter().filter(|c| !matches!(c, Component::Face)) {
        let all = motions.identifiable_orders(*component);
        let higher: Vec<usize> = all.iter().copied().filter(|order| *order > 1).collect();
        let symbol = component.symbol();
        let mut add = |symbol: String, orders: &[usize]| {
            if !orders.is_empty() {
                ranges.push(Range::new(motions, symbol, *component, orders));
            }
        };
        match component {
            Component::Roundness(section) => add(format!("RONt_{}", section + 1), &higher),
            _ => add(format!("{symbol}_synchronous"), &all),
        }
        if *component == Component::Z && all.first() == Some(&1) {
            add(format!("{symbol}_fundamental"), &[1]);
            add(format!("{symbol}_residual_synchronous"), &higher);
        }
    }
    let solution = motions.solution();
    let output = |range: &Range| Output {
        symbol: range.symbol.clone(),
        unit: unit(range.component),
        value: range.values(solution.as_ref())[0],
        slope: None,
    };
    let outputs: Vec<Output> = ranges.iter().map(output).collect();
    let values = move |unknowns: MatRef<'_, f64>| {
        let columns: Vec<Vec<f64>> = ranges.iter().map(|range| range.values(unknowns)).collect();
        Mat::from_fn(unknowns.nrows(), columns.len(), |trial, j| columns[j][trial])
    };
    NonlinearOutputs { outputs, values: Box::new(values) }
}
