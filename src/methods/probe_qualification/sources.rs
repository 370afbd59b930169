//! Sources of uncertainty as they act on the distances of the touches, mm.

use nalgebra::Vector3;

use super::bench::Bench;
use super::layout::{Layout, harmonic};
use super::observe::{Observed, Touch};
use crate::identification::declared::{
    display_step_mm, half_backlash_mm, linear_motion_patterns, rounding_mm,
};
use crate::identification::{Effect, EvaluationType, InResiduals, Shape, UncertaintySource};

/// How touches of one direction repeat.
#[derive(Debug, Clone, Copy)]
pub struct Scatter {
    /// Standard deviation of one touch, mm.
    pub s_mm: f64,
    pub dof: usize,
}

/// All sources, the touches' own scatter first.
pub fn sources(
    bench: &Bench<'_>,
    layout: &Layout,
    observed: &Observed,
    scatter: Scatter,
) -> Vec<UncertaintySource> {
    let touches = &observed.touches;
    let repeatability = Effect::Each(vec![scatter.s_mm; touches.len()]);
    let mut list = vec![
        UncertaintySource {
            evaluation: EvaluationType::A,
            dof: scatter.dof as f64,
            ..UncertaintySource::new("repeatability of a touch", repeatability)
        },
        UncertaintySource {
            shape: Shape::Rectangular,
            ..joint("resolution", resolution(bench, observed, scatter))
        },
        joint("form of the ball", form(bench, layout, touches)),
        joint("squareness of X, Y and Z", squareness(bench, observed)),
        joint("backlash", backlash(bench, touches)),
        joint("error motions of X, Y and Z", linear_axes(bench, touches)),
    ];
    list.retain(|source| !source.is_zero());
    list
}

fn joint(name: &str, columns: Vec<Vec<f64>>) -> UncertaintySource {
    UncertaintySource {
        in_residuals: InResiduals::Expected,
        is_in_weights: false,
        ..UncertaintySource::new(name, Effect::Joint(columns))
    }
}

/// What the scatter of the touches does not average out of rounding: one draw a direction.
fn resolution(bench: &Bench<'_>, observed: &Observed, scatter: Scatter) -> Vec<Vec<f64>> {
    let mut columns = vec![vec![0.0; observed.touches.len()]; observed.groups()];
    for (i, touch) in observed.touches.iter().enumerate() {
        let step_mm = display_step_mm(bench.plan, touch.normal);
        columns[touch.group][i] = rounding_mm(step_mm, scatter.s_mm);
    }
    columns
}

/// Of a section with the largest less the smallest radius f, any order may have the amplitude f/2, at any phase: its
/// cosine and its sine part have the standard deviation f/√8 each.
fn form(bench: &Bench<'_>, layout: &Layout, touches: &[Touch]) -> Vec<Vec<f64>> {
    let size_mm = bench.settings.form_um.unwrap_or(0.0) * 1e-3 / 8f64.sqrt();
    let orders = layout.map.iter().filter(|order| **order > 1);
    let column = |order: u32, part: usize| {
        touches.iter().map(|touch| size_mm * harmonic(order, &touch.normal)[part]).collect()
    };
    orders.flat_map(|order| [column(*order, 0), column(*order, 1)]).collect()
}

/// A ball of radius r is touched at r·n: where two axes lack e of a right angle, at r·e·n_i·n_j beyond.
fn squareness(bench: &Bench<'_>, observed: &Observed) -> Vec<Vec<f64>> {
    let size_mm = bench.plan.machine.squareness_urad * 1e-6 * observed.radius_mm;
    let touches = observed.touches.iter();
    let column = |(i, j): (usize, usize)| {
        touches.clone().map(|touch| size_mm * touch.normal[i] * touch.normal[j]).collect()
    };
    [(0, 1), (0, 2), (1, 2)].map(column).into()
}

/// Each axis lags behind the direction of the touch.
fn backlash(bench: &Bench<'_>, touches: &[Touch]) -> Vec<Vec<f64>> {
    let half = half_backlash_mm(bench.plan);
    let column = |k: usize| touches.iter().map(|touch| half[k] * touch.normal[k].abs()).collect();
    [0, 1, 2].map(column).into()
}

fn linear_axes(bench: &Bench<'_>, touches: &[Touch]) -> Vec<Vec<f64>> {
    let points: Vec<Vector3<f64>> = touches.iter().map(|touch| touch.axes_mm).collect();
    let along = |k: usize, pattern: &[f64]| {
        touches.iter().zip(pattern).map(|(touch, by)| touch.normal[k] * by).collect::<Vec<f64>>()
    };
    let patterns = linear_motion_patterns(bench.plan, &points);
    patterns.iter().flat_map(|pattern| [0, 1, 2].map(|k| along(k, pattern))).collect()
}
