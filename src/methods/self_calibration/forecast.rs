//! What a run will reach, from its plan alone.

use super::estimate;
use super::identify::{nominal_reading, parts};
use super::plan::Planner;
use super::settings::Settings;
use crate::IdentifyError;
use crate::identification::KnownMotions;
use machine::Axis;
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// What a sentence on error motions that are not identifiable begins with.
const ALIASED: &str = "error motions of";
const MOST_POSITIONS: usize = 72;

/// U that a plan with all steps at nominal positions will reach, and which deviations of a single touch it will find;
/// `machine_s` of machine time.
///
/// # Errors
/// A cycle that cannot be identified.
pub fn forecast(
    plan: &Plan,
    settings: &Settings,
    planner: &Planner<'_>,
    known: &KnownMotions<'_>,
    machine_s: f64,
) -> Result<Vec<String>, IdentifyError> {
    let mut readings: Vec<Reading> =
        (0..settings.repeats).flat_map(|repeat| nominal_pass(plan, repeat)).collect();
    let interval_s = machine_s / readings.len().max(1) as f64;
    for (number, reading) in readings.iter_mut().enumerate() {
        reading.t_s = interval_s * number as f64;
    }
    let parts = parts(plan, settings, planner, known, &readings, |_| None)?;
    let estimate = estimate::estimate(&parts);
    let expected = estimate.parameters.iter().filter(|parameter| !parameter.budget.is_empty());
    let expected: Vec<String> =
        expected.map(|p| format!("{} {:.1} {}", p.symbol, p.expanded, p.unit.symbol())).collect();
    let aliased = estimate.not_identifiable.into_iter().filter(|line| line.starts_with(ALIASED));
    let expected = format!("expected U: {}", expected.join(", "));
    let limits = parts.identification.checked.limits();
    let better = better_positions(plan, planner.axis().axis, parts.fit.layout.design.n);
    Ok([expected].into_iter().chain(aliased).chain(better).chain(limits).collect())
}

/// Where the axis is known to have error motions that its positions cannot tell from its location: how many could.
fn better_positions(plan: &Plan, axis: Axis, n: usize) -> Option<String> {
    let orders = &plan.machine.axes.get(&axis)?.error_motion_orders;
    let is_lost = |n: usize| orders.iter().any(|order| (*order as usize).is_multiple_of(n));
    if !is_lost(n) {
        return None;
    }
    let better = (n + 1..=MOST_POSITIONS).find(|n| n.is_multiple_of(4) && !is_lost(*n))?;
    Some(format!("positions = {better} would separate all error_motion_orders of {axis}"))
}

fn nominal_pass(plan: &Plan, repeat: u32) -> impl Iterator<Item = Reading> {
    let touches = plan.steps.iter().filter(|step| step.scan.is_none() && step.text.is_none());
    touches.map(move |step| Reading { repeat, ..nominal_reading(step) })
}
