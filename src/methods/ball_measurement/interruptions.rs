//! Shifts of the machine at interruptions of the measurement, as an effect of an uncertainty source.

use nalgebra::Vector3;

use super::observation_effects::{effect_of_nonzero_columns, shift_column};
use super::observe::BallCentre;
use crate::decision::reference_shifts::{
    ReferencePair, ReferenceShift, ShiftLimits, TouchScatter, compared_reference_point_count,
};
use crate::identification::ObservationEffect;
use crate::identification::declared_sources::{control_resolution_mm, drift_rate_sd_mm_per_s, repeatability_mm};
use machine::Axis;
use machine::record::plan::Plan;

/// Measurements after an interruption may be shifted against those before it in X, Y and Z, by at most the
/// limit of the reference check. The whole limit counts as standard uncertainty: the distribution of the
/// steps is unknown, and a step near the limit in all three axes is still covered.
pub fn interruption_effect(plan: &Plan, centres: &[BallCentre]) -> ObservationEffect {
    effect_of_nonzero_columns(
        plan.interruption_times_s.iter().flat_map(|gap_s| interruption_shift_columns(plan, centres, *gap_s)),
    )
}

/// Columns of the shift of the machine at one interruption; none unless there are measurements before and after it.
fn interruption_shift_columns(plan: &Plan, centres: &[BallCentre], interruption_time_s: f64) -> Vec<Vec<f64>> {
    let times = || centres.iter().map(|centre| centre.mean_time_s);
    let before = times().filter(|t_s| *t_s <= interruption_time_s).reduce(f64::max);
    let after = times().filter(|t_s| *t_s > interruption_time_s).reduce(f64::min);
    let (Some(before), Some(after)) = (before, after) else { return Vec::new() };
    let step = |axis: Axis| {
        let u = reference_shift_limit_mm(plan, axis, [before, after]);
        shift_column(
            times().map(|t_s| if t_s > interruption_time_s { axis.nominal_direction() * u } else { Vector3::zeros() }),
        )
    };
    Axis::LINEAR.into_iter().map(step).collect()
}

/// Limit of the shift of a reference that is touched along the axis at the times `t_s`, mm.
fn reference_shift_limit_mm(plan: &Plan, axis: Axis, t_s: [f64; 2]) -> f64 {
    let pair = ReferencePair {
        label: String::new(),
        position_before_after_mm: [0.0; 2],
        times_in_run_before_after_s: t_s,
        resolution_mm: control_resolution_mm(plan, axis.nominal_direction()),
    };
    let scatter = TouchScatter::Declared { u_mm: repeatability_mm(plan) };
    ReferenceShift::from_pair(
        &pair,
        &ShiftLimits::new(scatter, compared_reference_point_count(plan), drift_rate_sd_mm_per_s(plan)),
    )
    .limit_mm
}
