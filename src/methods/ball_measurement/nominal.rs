//! Nominal readings of a plan.

use super::label::{Label, MeasurementPass};
use machine::record::plan::{Plan, Step};
use machine::record::reading::{Reading, ReadingFlag};

/// Readings of the slow touches as if each made contact at its start point, at equal time intervals. A
/// standoff that is the same for all touches of a ball changes only the radius.
pub fn nominal_readings(plan: &Plan, machine_s: f64) -> Vec<Reading> {
    let is_slow = |step: &&Step| step.label.parse::<Label>().is_ok_and(|label| label.pass == MeasurementPass::Slow);
    let steps: Vec<&Step> = plan.steps.iter().filter(is_slow).collect();
    let interval_s = machine_s / steps.len().max(1) as f64;
    let reading = |(i, step): (usize, &&Step)| Reading {
        step: step.id,
        repeat: 0,
        position: step.from.clone(),
        value_mm: None,
        sensor: step.first_sensor().to_owned(),
        t_s: interval_s * i as f64,
        flag: ReadingFlag::None,
        temperatures_c: Default::default(),
    };
    steps.iter().enumerate().map(reading).collect()
}
