//! Total and asynchronous error motion values, from the single revolutions.

use std::f64::consts::TAU;

use estimation::linear::{self, LinearProblem, RANK_THRESHOLD};
use faer::Mat;
use machine::record::estimate::Parameter;

use super::harmonics::RowRevolutions;
use super::model::{Component, ProbeLayout, Row};
use super::outputs::{ReportedMotions, unit};
use crate::identification::{range, reported_parameter};

/// Total and asynchronous value of each error motion, mean over the indexes with the standard uncertainty
/// of that mean (type A; none for one index). Both contain the noise of the sensors. A motion that the
/// channels of an index do not determine has no value from that index.
///
/// The asynchronous value is the largest range over the revolutions at one angle, the total value the
/// range over all angles and revolutions.
pub fn revolution_values(
    layout: &ProbeLayout,
    motions: &ReportedMotions<'_>,
    measured: &[RowRevolutions],
) -> Vec<Parameter> {
    let mut parameters = Vec::new();
    for component in layout.components() {
        if matches!(component, Component::Roundness(_) | Component::Face) {
            continue;
        }
        let indexes = 0..layout.index_angles_rad.len();
        let values: Vec<MotionRanges> = indexes
            .filter_map(|index| {
                let own = measured.iter().filter(|row| row.row.index == index).collect::<Vec<_>>();
                MotionRanges::new(layout, motions, &own, component)
            })
            .collect();
        let totals: Vec<f64> = values.iter().map(|value| value.total).collect();
        let asynchronous: Vec<f64> = values.iter().map(|value| value.asynchronous).collect();
        for (suffix, values) in [("total", totals), ("asynchronous", asynchronous)] {
            let symbol = format!("{}_{suffix}", component.symbol());
            parameters.extend(mean_parameter(&symbol, component, &values));
        }
    }
    parameters
}

fn mean_parameter(symbol: &str, component: Component, values: &[f64]) -> Option<Parameter> {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    let u = (squares / (count - 1.0) / count).sqrt();
    let parameter = reported_parameter(symbol, unit(component), mean, u, Some(count - 1.0));
    // The scatter of one index is not known.
    (values.len() > 1).then_some(parameter)
}

/// Values at one index.
struct MotionRanges {
    total: f64,
    asynchronous: f64,
}

impl MotionRanges {
    /// `own`: the rows of the index. `None`: their channels do not determine the motion.
    fn new(
        layout: &ProbeLayout,
        motions: &ReportedMotions<'_>,
        own: &[&RowRevolutions],
        component: Component,
    ) -> Option<Self> {
        let gain = motion_gain(layout, own, component)?;
        let (count, samples) = (own[0].revolutions.len(), own[0].revolutions[0].len());
        let orders = motions.identifiable_orders(component);
        let (mut asynchronous, mut all) = (0.0_f64, Vec::new());
        for i in 0..samples {
            let mean = |row: &RowRevolutions| {
                row.revolutions.iter().map(|revolution| revolution[i]).sum::<f64>() / count as f64
            };
            let deviation = |r: usize| -> f64 {
                let rows = own.iter().zip(&gain);
                rows.map(|(row, gain)| gain * (row.revolutions[r][i] - mean(row))).sum()
            };
            let deviations: Vec<f64> = (0..count).map(deviation).collect();
            asynchronous = asynchronous.max(range(&deviations));
            let synchronous = motions.value_at(component, &orders, i as f64 * TAU / samples as f64);
            all.extend(deviations.iter().map(|deviation| synchronous + deviation));
        }
        Some(Self { total: range(&all), asynchronous })
    }
}

/// One factor a row: the motion at one angle from the deviations of the channels. The artefact is the same
/// in each revolution and drops out.
fn motion_gain(
    layout: &ProbeLayout,
    own: &[&RowRevolutions],
    component: Component,
) -> Option<Vec<f64>> {
    let rows: Vec<Row> = own.iter().map(|row| row.row).collect();
    let components = layout.components();
    let is_form = |c: &Component| matches!(c, Component::Roundness(_) | Component::Face);
    let columns: Vec<usize> = (0..components.len()).filter(|j| !is_form(&components[*j])).collect();
    let design = layout.design(&rows, 0);
    let a = Mat::from_fn(rows.len(), columns.len(), |i, j| design[(i, 2 * columns[j])]);
    let problem = LinearProblem {
        a: a.as_ref(),
        y: &vec![0.0; rows.len()],
        sigma: &vec![1.0; rows.len()],
        constraints: None,
        rank_threshold: RANK_THRESHOLD,
    };
    let solution = linear::solve(&problem).ok()?;
    let position = columns.iter().position(|j| components[*j] == component)?;
    Some((0..rows.len()).map(|i| solution.gain[(position, i)]).collect())
}
