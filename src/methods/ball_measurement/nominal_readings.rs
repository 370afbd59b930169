//! Nominal readings of a plan.

use super::touch_label::{MeasurementPurpose, TouchLabel, touch_steps_with_labels};
use machine::record::plan::{Plan, Step};
use machine::record::reading::Reading;

/// Readings of the slow touches as if each made contact at its start point, at equal time intervals. A
/// standoff that is the same for all touches of a ball changes only the radius.
pub fn nominal_readings(plan: &Plan, machine_time_s: f64) -> Vec<Reading> {
    let steps: Vec<(&Step, TouchLabel)> =
        touch_steps_with_labels(plan).filter(|(_, label)| label.purpose == MeasurementPurpose::Slow).collect();
    let interval_s = machine_time_s / steps.len().max(1) as f64;
    let numbered = steps.into_iter().enumerate();
    numbered.map(|(i, (step, _))| Reading::at_touch_start(step, interval_s * i as f64)).collect()
}
