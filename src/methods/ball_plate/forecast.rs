//! Expected uncertainty of a run, from its plan alone.

use super::identify::identify_solved;
use super::plate::Plate;
use super::settings::BallPlateSettings;
use super::solved::SolvedRun;
use super::unknowns_layout::MOTION_COMPONENTS;
use super::warnings::describe_not_identifiable;
use crate::IdentifyError;
use crate::ball_measurement::nominal_readings;
use crate::identification::{
    Identification, OutputCurve, describe_assumed_repeatability, plan_with_assumed_repeatability,
};
use machine::record::plan::Plan;

/// Lines for the user: largest expected U of each error motion over its curve, an assumed repeatability if none is
/// declared, then one line for each limit of what is identifiable. `plan`: all stages, planned from nominal
/// positions. `machine_time_s`: machine time of the plan, s.
///
/// # Errors
/// The visits of the plan do not separate the unknowns.
pub fn describe_forecast(
    plan: &Plan,
    settings: &BallPlateSettings,
    machine_time_s: f64,
) -> Result<Vec<String>, IdentifyError> {
    let declared = plan_with_assumed_repeatability(plan);
    let plate = Plate::new(&declared, settings)?;
    let solved = SolvedRun::new(&declared, settings, &plate, &nominal_readings(plan, machine_time_s))?;
    let identified = identify_solved(&solved, None)?;
    let motions = identified.outputs.curves.iter().take(MOTION_COMPONENTS.len());
    let motions: Vec<String> =
        motions.map(|motion| describe_largest_expanded_uncertainty(&identified, motion)).collect();
    let mut lines =
        vec![format!("expected U of the error motions after {:.1} h: {}", machine_time_s / 3600.0, motions.join(", "))];
    lines.extend(describe_assumed_repeatability(plan));
    lines
        .extend(describe_not_identifiable(&solved, &identified).iter().map(|line| format!("not identifiable: {line}")));
    Ok(lines)
}

/// The largest U of the points of the curve, as text.
fn describe_largest_expanded_uncertainty(identified: &Identification, curve: &OutputCurve) -> String {
    let expanded = |slope: &Vec<f64>| identified.propagation.output_uncertainty(slope).expanded();
    let largest = curve.slopes.iter().map(expanded).fold(0.0, f64::max);
    let largest = curve.unit.to_reported_value(largest);
    let decimals = if largest < 1.0 { 2 } else { 1 };
    format!("{} {largest:.decimals$} {}", curve.symbol, curve.unit.symbol())
}
