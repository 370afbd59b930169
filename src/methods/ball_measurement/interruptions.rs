//! Steps of the machine at interruptions of the measurement.

use nalgebra::Vector3;

use super::effects::{nonzero_columns, shift_column};
use super::observe::BallCentre;
use crate::decision::references::{ReferencePair, ReferenceShift, ShiftLimits, TouchScatter, reference_point_count};
use crate::identification::ObservationEffect;
use crate::identification::declared::{display_step_mm, drift_mm_per_s, repeatability_mm};
use machine::Axis;
use machine::record::plan::Plan;

/// Measurements after an interruption may be shifted against those before it in X, Y and Z, by at most the
/// limit of the reference check. The whole limit counts as standard uncertainty: the distribution of the
/// steps is unknown, and a step near the limit in all three axes is still covered.
pub fn interruption_effect(plan: &Plan, centres: &[BallCentre]) -> ObservationEffect {
    nonzero_columns(plan.gaps_s.iter().flat_map(|gap_s| step_columns(plan, centres, *gap_s)))
}

/// Columns of the step at one interruption; none unless there are measurements before and after it.
fn step_columns(plan: &Plan, centres: &[BallCentre], gap_s: f64) -> Vec<Vec<f64>> {
    let times = || centres.iter().map(|centre| centre.t_s);
    let before = times().filter(|t_s| *t_s <= gap_s).reduce(f64::max);
    let after = times().filter(|t_s| *t_s > gap_s).reduce(f64::min);
    let (Some(before), Some(after)) = (before, after) else { return Vec::new() };
    let step = |axis: Axis| {
        let u = reference_limit_mm(plan, axis, [before, after]);
        shift_column(times().map(|t_s| if t_s > gap_s { axis.direction() * u } else { Vector3::zeros() }))
    };
    Axis::LINEAR.into_iter().map(step).collect()
}

/// Limit of a reference that is touched along the axis, mm.
fn reference_limit_mm(plan: &Plan, axis: Axis, t_s: [f64; 2]) -> f64 {
    let pair = ReferencePair {
        label: String::new(),
        position_mm: [0.0; 2],
        t_s,
        resolution_mm: display_step_mm(plan, axis.direction()),
    };
    let scatter = TouchScatter::Declared { u_mm: repeatability_mm(plan) };
    ReferenceShift::from_pair(&pair, &ShiftLimits::new(scatter, reference_point_count(plan), drift_mm_per_s(plan)))
        .limit_mm
}
