//! What a run will reach, from its plan alone.

use super::identify::identified;
use super::layout::COMPONENTS;
use super::plate::Plate;
use super::settings::Settings;
use super::solved::Solved;
use super::warnings::not_identifiable;
use crate::IdentifyError;
use crate::ball_measurement::{Label, Pass};
use crate::identification::declared::repeatability_mm;
use crate::identification::{Curve, Identification};
use machine::record::plan::{Plan, Step};
use machine::record::reading::{Flag, Reading};

/// Expected U of the error motions, and what is not identifiable, a line each. `plan`: with all steps at nominal
/// positions, of `machine_s` of machine time.
///
/// # Errors
/// A plan whose visits do not separate the unknowns.
pub fn forecast(
    plan: &Plan,
    settings: &Settings,
    machine_s: f64,
) -> Result<Vec<String>, IdentifyError> {
    let plate = Plate::new(plan, settings)?;
    let solved = Solved::new(plan, settings, &plate, &nominal_readings(plan, machine_s))?;
    // Residuals of nominal readings judge nothing.
    let identified = identified(&solved, true, None)?;
    let motions = identified.outputs.curves.iter().take(COMPONENTS.len());
    let motions: Vec<String> = motions.map(|motion| largest(&identified, motion)).collect();
    let mut lines = vec![format!(
        "expected U of the error motions after {:.1} h: {}",
        machine_s / 3600.0,
        motions.join(", ")
    )];
    if plan.probe.repeatability_um.is_none() {
        let assumed_um = repeatability_mm(plan) * 1e3;
        lines.push(format!(
            "assumed for the expected U: repeatability_um = {assumed_um} of a touch; state it in [probe]"
        ));
    }
    lines.extend(
        not_identifiable(&solved, &identified)
            .iter()
            .map(|line| format!("not identifiable: {line}")),
    );
    Ok(lines)
}

/// The largest U of a point of the curve.
fn largest(identified: &Identification, curve: &Curve) -> String {
    let expanded = |slope: &Vec<f64>| identified.propagation.uncertainty(slope).expanded();
    let largest = curve.slopes.iter().map(expanded).fold(0.0, f64::max);
    let largest = curve.unit.from_internal(largest);
    let decimals = if largest < 1.0 { 2 } else { 1 };
    format!("{} {largest:.decimals$} {}", curve.symbol, curve.unit.symbol())
}

/// Slow touches as if each made contact where it sets out, at equal intervals of time. A standoff that is the same for
/// all touches of a ball changes its radius alone.
fn nominal_readings(plan: &Plan, machine_s: f64) -> Vec<Reading> {
    let is_slow =
        |step: &&Step| step.label.parse::<Label>().is_ok_and(|label| label.pass == Pass::Slow);
    let steps: Vec<&Step> = plan.steps.iter().filter(is_slow).collect();
    let interval_s = machine_s / steps.len().max(1) as f64;
    let reading = |(i, step): (usize, &&Step)| Reading {
        step: step.id,
        repeat: 0,
        position: step.from.clone(),
        value_mm: None,
        sensor: step.sensor().to_owned(),
        t_s: interval_s * i as f64,
        flag: Flag::None,
        temperatures_c: Default::default(),
    };
    steps.iter().enumerate().map(reading).collect()
}
