//! Forecast of the results of a run, from its plan alone.

use super::estimate;
use super::identify::{reading_at_touch_start, solve_readings};
use super::setup::SelfCalibrationSetup;
use crate::IdentifyError;
use crate::identification::{
    describe_assumed_repeatability, describe_expected_uncertainty, plan_with_assumed_repeatability,
};
use machine::Axis;
use machine::record::plan::{Plan, Step};
use machine::record::reading::Reading;

/// Prefix of the texts on error motions that are not identifiable.
const ALIASING_LINE_PREFIX: &str = "error motions of";
const MAX_SUGGESTED_POSITIONS: usize = 72;

/// Expected U for a plan with all steps at nominal positions, and the smallest deviations of a single touch that
/// are detectable. `machine_s`: machine time, s.
///
/// # Errors
/// The nominal readings do not separate the unknowns.
pub fn forecast_results(setup: &SelfCalibrationSetup<'_>, machine_s: f64) -> Result<Vec<String>, IdentifyError> {
    let SelfCalibrationSetup { plan, settings, .. } = *setup;
    let mut readings = nominal_readings(setup);
    let unchecked = unchecked_step_ids(setup)?;
    let again = readings.iter().filter(|one| one.repeat == 0 && unchecked.contains(&one.step));
    let again: Vec<Reading> = again.map(|one| Reading { repeat: settings.repeats, ..one.clone() }).collect();
    let repeated =
        (!again.is_empty()).then(|| format!("touches without redundancy, repeated at the end: {}", again.len()));
    readings.extend(again);
    let interval_s = machine_s / readings.len().max(1) as f64;
    for (number, reading) in readings.iter_mut().enumerate() {
        reading.t_s = interval_s * number as f64;
    }
    let declared = forecast_plan(plan);
    let declared = SelfCalibrationSetup::new(&declared, settings)?.with_known_motions()?;
    let parts = solve_readings(&declared, &readings, false)?;
    let estimate = estimate::build_estimate(&parts);
    let symbols = &estimate.covariance.symbols;
    let expected =
        describe_expected_uncertainty(&estimate, |parameter| symbols.contains(&parameter.symbol)).into_iter();
    let aliased = estimate.not_identifiable.into_iter().filter(|line| line.starts_with(ALIASING_LINE_PREFIX));
    let limits = parts.identification.outlier_check.describe_detection_limits();
    let better = suggest_position_count(plan, setup.axis.axis, parts.fit.layout.design.angle_count);
    Ok(expected
        .chain(describe_assumed_repeatability(plan))
        .chain(aliased)
        .chain(better)
        .chain(repeated)
        .chain(limits)
        .collect())
}

/// Text that suggests more positions, a multiple of 4, if the grid of `n` angles does not separate the declared error
/// motion orders of the axis from its location. `None`: the grid separates them, or no number up to 72 does.
fn suggest_position_count(plan: &Plan, axis: Axis, n: usize) -> Option<String> {
    let orders = &plan.machine.axes.get(&axis)?.error_motion_orders;
    let is_lost = |n: usize| orders.iter().any(|order| (*order as usize).is_multiple_of(n));
    if !is_lost(n) {
        return None;
    }
    let better = (n + 1..=MAX_SUGGESTED_POSITIONS).find(|n| n.is_multiple_of(4) && !is_lost(*n))?;
    Some(format!("positions = {better} would separate all error_motion_orders of {axis}"))
}

/// Ids of the steps whose touches are not checked by any other touch after all passes.
///
/// # Errors
/// The errors of [`forecast_results`].
pub fn unchecked_step_ids(setup: &SelfCalibrationSetup<'_>) -> Result<Vec<u32>, IdentifyError> {
    let declared = forecast_plan(setup.plan);
    let declared = SelfCalibrationSetup::new(&declared, setup.settings)?.with_known_motions()?;
    let parts = solve_readings(&declared, &nominal_readings(setup), false)?;
    let checks = &parts.identification.outlier_check.measurement_checks;
    let is_unchecked =
        |step: &&Step| checks.iter().any(|one| one.min_detectable_deviation_um.is_none() && one.label == step.label);
    Ok(setup.plan.steps.iter().filter(is_unchecked).map(|step| step.id).collect())
}

/// The plan without prompts and interruption times, with an assumed repeatability if none is declared.
fn forecast_plan(plan: &Plan) -> Plan {
    let mut declared = plan_with_assumed_repeatability(plan);
    declared.steps.retain(|step| step.text.is_none());
    // The interruption times of the run do not apply to the nominal readings.
    declared.interruption_times_s.clear();
    declared
}

/// One reading at the start of each touch for each of the `repeats` passes.
fn nominal_readings(setup: &SelfCalibrationSetup<'_>) -> Vec<Reading> {
    let touches = setup.plan.steps.iter().filter(|step| step.scan.is_none() && step.text.is_none());
    let touches: Vec<Reading> = touches.map(reading_at_touch_start).collect();
    let pass = |repeat| touches.iter().map(move |one| Reading { repeat, ..one.clone() });
    (0..setup.settings.repeats).flat_map(pass).collect()
}
