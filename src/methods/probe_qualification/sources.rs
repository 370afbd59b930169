//! Sources of uncertainty and their effects on the distances of the touches, mm.

use machine::Axis;
use nalgebra::Vector3;

use super::observe::{MeasuredTouch, ObservedTouches};
use super::setup::QualificationSetup;
use super::unknowns_layout::{UnknownsLayout, harmonic_factors};
use crate::identification::declared_sources::{
    control_resolution_mm, half_backlash_mm, linear_motion_patterns, rounding_u_of_mean_mm,
};
use crate::identification::{
    DrawDistribution, EvaluationType, ObservationEffect, ResidualTreatment, UncertaintySource,
};

/// Scatter of touches in one direction, pooled over all directions.
#[derive(Debug, Clone, Copy)]
pub struct PooledScatter {
    /// Standard deviation of one touch as displayed, with the rounding of the display, mm.
    pub std_dev_mm: f64,
    /// Number of touches minus number of groups.
    pub dof: usize,
    /// Largest resolution of the linear axes as displayed by the control, mm.
    pub control_resolution_mm: f64,
}

impl PooledScatter {
    /// Standard uncertainty of one touch, mm: the displayed scatter, and the part of the rounding error that the
    /// scatter does not average out.
    pub fn touch_std_u_mm(self) -> f64 {
        self.std_dev_mm.hypot(rounding_u_of_mean_mm(self.control_resolution_mm, self.std_dev_mm))
    }

    /// Standard deviation of one touch without the rounding of the display, and the standard uncertainty of this
    /// deviation, mm. Rounding errors of touches that scatter by more than half a display step are independent and
    /// rectangular. Rounding errors of touches that scatter less increase the uncertainty.
    pub fn std_dev_and_u_without_rounding_mm(self) -> [f64; 2] {
        let variance = self.std_dev_mm.powi(2) - self.control_resolution_mm.powi(2) / 12.0;
        let s_mm = variance.max(0.0).sqrt();
        let of_count = self.std_dev_mm.powi(2) * (2.0 / self.dof.max(1) as f64).sqrt();
        let u_variance = of_count.hypot(rounding_u_of_mean_mm(self.control_resolution_mm, self.std_dev_mm).powi(2));
        // u(s²) = 2·s·u(s). At s = 0 the square root of u(s²) is the upper bound of u(s).
        [s_mm, (u_variance / (2.0 * s_mm.max(f64::MIN_POSITIVE))).min(u_variance.sqrt())]
    }
}

/// All sources, with the scatter of the touches first.
pub fn uncertainty_sources(
    setup: &QualificationSetup<'_>,
    layout: &UnknownsLayout,
    observed: &ObservedTouches,
    scatter: PooledScatter,
) -> Vec<UncertaintySource> {
    let touches = &observed.touches;
    let repeatability = ObservationEffect::Independent(vec![scatter.std_dev_mm; touches.len()]);
    let mut list = vec![
        UncertaintySource {
            evaluation: EvaluationType::A,
            dof: scatter.dof as f64,
            ..UncertaintySource::new("repeatability of a touch", repeatability)
        },
        UncertaintySource {
            draw_distribution: DrawDistribution::Rectangular,
            ..joint_source("resolution", resolution_columns(setup, observed, scatter))
        },
        joint_source("form of the ball", ball_form_columns(setup, layout, touches)),
        joint_source("squareness of X, Y and Z", squareness_columns(setup, observed)),
        joint_source("backlash", backlash_columns(setup, touches)),
        joint_source("error motions of S", spindle_error_columns(setup, observed)),
        joint_source("error motions of X, Y and Z", linear_axis_error_columns(setup, touches)),
    ];
    list.retain(|source| !source.is_zero());
    list
}

/// Source whose declared size enters the expected χ² but not the weights.
fn joint_source(name: &str, columns: Vec<Vec<f64>>) -> UncertaintySource {
    UncertaintySource {
        residual_treatment: ResidualTreatment::InExpectedChi2,
        is_in_weights: false,
        ..UncertaintySource::new(name, ObservationEffect::Joint(columns))
    }
}

/// Part of the rounding error that the scatter of the touches does not average out: one draw per group of touches.
fn resolution_columns(
    setup: &QualificationSetup<'_>,
    observed: &ObservedTouches,
    scatter: PooledScatter,
) -> Vec<Vec<f64>> {
    let mut columns = vec![vec![0.0; observed.touches.len()]; observed.group_count()];
    for (i, touch) in observed.touches.iter().enumerate() {
        let step_mm = control_resolution_mm(setup.plan, touch.normal_in_machine);
        columns[touch.group_index][i] = rounding_u_of_mean_mm(step_mm, scatter.std_dev_mm);
    }
    columns
}

/// If the largest and smallest radius of a section differ by f, any order may have the amplitude f/2 at any phase. The
/// cosine and sine parts of the order then have the standard deviation f/√8 each.
fn ball_form_columns(
    setup: &QualificationSetup<'_>,
    layout: &UnknownsLayout,
    touches: &[MeasuredTouch],
) -> Vec<Vec<f64>> {
    let size_mm = setup.settings.certified_roundness_um.unwrap_or(0.0) * 1e-3 / 8f64.sqrt();
    let orders = layout.map_orders.iter().filter(|order| **order > 1);
    let column = |order: u32, part: usize| {
        touches.iter().map(|touch| size_mm * harmonic_factors(order, &touch.normal_in_machine)[part]).collect()
    };
    orders.flat_map(|order| [column(*order, 0), column(*order, 1)]).collect()
}

/// Squareness: a ball of radius r is touched at r·n. Two axes whose angle differs by e from a right angle change
/// the distance by r·e·n_i·n_j.
fn squareness_columns(setup: &QualificationSetup<'_>, observed: &ObservedTouches) -> Vec<Vec<f64>> {
    let size_mm = setup.plan.machine.squareness_urad * 1e-6 * observed.stated_radius_sum_mm;
    let touches = observed.touches.iter();
    let column = |(i, j): (usize, usize)| {
        touches.clone().map(|touch| size_mm * touch.normal_in_machine[i] * touch.normal_in_machine[j]).collect()
    };
    [(0, 1), (0, 2), (1, 2)].map(column).into()
}

/// Error motion of the spindle: the ball is displaced in the spindle frame at each orientation.
fn spindle_error_columns(setup: &QualificationSetup<'_>, observed: &ObservedTouches) -> Vec<Vec<f64>> {
    let size_mm = setup.plan.machine.axes.get(&Axis::S).map_or(0.0, |spec| spec.error_motion_um * 1e-3);
    let column = |orientation: usize, k: usize| {
        let at = |touch: &MeasuredTouch| {
            if touch.spindle_orientation_index == orientation { touch.normal_in_machine[k] } else { 0.0 }
        };
        observed.touches.iter().map(|touch| size_mm * at(touch)).collect()
    };
    let orientations = 0..observed.spindle_orientations_deg.len();
    orientations.flat_map(|orientation| [0, 1, 2].map(|k| column(orientation, k))).collect()
}

/// Backlash: each axis lags behind in the direction of the touch.
fn backlash_columns(setup: &QualificationSetup<'_>, touches: &[MeasuredTouch]) -> Vec<Vec<f64>> {
    let half = half_backlash_mm(setup.plan);
    let column = |k: usize| touches.iter().map(|touch| half[k] * touch.normal_in_machine[k].abs()).collect();
    [0, 1, 2].map(column).into()
}

/// Error motions of X, Y and Z: each pattern displaces the contact along X, along Y or along Z, with one draw each.
fn linear_axis_error_columns(setup: &QualificationSetup<'_>, touches: &[MeasuredTouch]) -> Vec<Vec<f64>> {
    let points: Vec<Vector3<f64>> = touches.iter().map(|touch| touch.axis_positions_mm).collect();
    let along = |k: usize, pattern: &[f64]| {
        touches.iter().zip(pattern).map(|(touch, by)| touch.normal_in_machine[k] * by).collect::<Vec<f64>>()
    };
    let patterns = linear_motion_patterns(setup.plan, &points);
    patterns.iter().flat_map(|pattern| [0, 1, 2].map(|k| along(k, pattern))).collect()
}
