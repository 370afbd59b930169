//! Warnings of the estimate.

use super::geometry_solution::GeometrySolution;
use crate::ball_measurement::tilts_table;
use crate::identification::{Identification, MisfitAdvice};
use machine::Position;
use machine::kinematics::{ErrorParameter, ErrorShape};

const MISFIT_ADVICE: MisfitAdvice = MisfitAdvice {
    possible_causes: "error motions, sag, drift or a loose ball",
    declaring_settings: "repeatability_um or error_motion_um",
};

const BALL_FAULT_ADVICE: &str = "check for dirt, a loose ball or a wrong stylus";

pub fn estimate_warnings(solved: &GeometrySolution<'_>, identified: &Identification) -> Vec<String> {
    let mut lines = solved.observed.skipped_measurements.clone();
    lines.extend(misfit_warning(solved, identified));
    lines.extend(solved.moved_ball_warning());
    lines.extend(identified.outlier_check.warnings.iter().cloned());
    lines.extend(solved.length_disagreement_warnings());
    lines.extend(ball_form_warnings(solved));
    lines.extend(missing_temperature_warnings(solved));
    lines.extend(identified.trial_contradiction_warning());
    lines.extend(unstable_trials_warning(identified));
    lines
}

/// Warning of a misfit. Above the bound it also names the errors that a sag of the table would change.
fn misfit_warning(solved: &GeometrySolution<'_>, identified: &Identification) -> Option<String> {
    let warning = identified.misfit_warning(&MISFIT_ADVICE)?;
    let is_above = identified.propagation.misfit.is_above_bound;
    Some(if is_above { warning + &describe_sag_errors(solved) } else { warning })
}

/// Text that names the identified errors that a sag of the table would change. Empty: no axis tilts the table, or none
/// of these errors is identified. Sag follows the tilt. The effect of sag resembles a rotation about the tilting axis,
/// and offsets of the axes that the tilting axis carries.
fn describe_sag_errors(solved: &GeometrySolution<'_>) -> String {
    let model = solved.problem.model();
    let table = model.chain().topology().workpiece_branch();
    let Some(at) = table.iter().position(|axis| tilts_table(model.chain(), *axis)) else {
        return String::new();
    };
    let (tilting, carried) = (table[at], &table[at + 1..]);
    let is_affected = |error: &&ErrorParameter| {
        let offset = error.component().is_linear() && carried.contains(&error.axis());
        error.shape() == ErrorShape::Location && (error.component() == tilting || offset)
    };
    let names: Vec<String> = model.parameters().iter().filter(is_affected).map(ToString::to_string).collect();
    if names.is_empty() {
        return String::new();
    }
    format!(". Sag of the table under the tilt of {tilting} would appear in {}", names.join(", "))
}

/// Warnings of balls with a large form error, and of diameters that differ from the stated ones. The median
/// difference of all measurements is pre-travel and is subtracted.
fn ball_form_warnings(solved: &GeometrySolution<'_>) -> Vec<String> {
    let centres = &solved.observed.centres;
    let stylus = solved.plan.probe.ball_radius_mm;
    let radius = |ball: usize| solved.balls.balls[ball].radius_mm + stylus;
    let radius_errors: Vec<f64> =
        centres.iter().map(|centre| centre.contact_radius_mm - radius(centre.ball_index)).collect();
    let mut sorted = radius_errors.clone();
    sorted.sort_by(f64::total_cmp);
    let common = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    let mut lines = Vec::new();
    for (centre, radius_error) in centres.iter().zip(&radius_errors) {
        let (form_um, off_um) = (centre.form_mm * 1e3, 2e3 * (radius_error - common));
        let subject = format!("ball {} at indexation {}", centre.label.ball, centre.label.indexation_number());
        if form_um > solved.settings.form_limit_um {
            lines.push(format!("{subject}: the form error is {form_um:.1} µm: {BALL_FAULT_ADVICE}"));
        }
        if off_um.abs() > solved.settings.diameter_limit_um {
            lines.push(format!(
                "{subject}: the diameter differs by {off_um:+.1} µm from the others: {BALL_FAULT_ADVICE}"
            ));
        }
    }
    lines
}

/// One warning for each certified length that has an expansion coefficient but no temperature.
fn missing_temperature_warnings(solved: &GeometrySolution<'_>) -> Vec<String> {
    let lengths = solved.balls.lengths.iter();
    let unknown = lengths.filter(|length| length.expansion_um_per_m_k != 0.0 && length.temperature_c.is_none());
    let lines = unknown.map(|length| {
        format!(
            "the temperature of the certified length {}–{} is not stated: 20 °C is assumed with a \
             standard uncertainty of {} K; each kelvin changes all gains by {:.1} µm/m",
            length.from, length.to, length.u_temperature_k, length.expansion_um_per_m_k
        )
    });
    lines.collect()
}

/// JCGM 101, 7.9: the maximum number of trials did not satisfy the stopping rule.
fn unstable_trials_warning(identified: &Identification) -> Option<String> {
    let trials = identified.trial_statistics.as_ref().filter(|trials| !trials.is_stable)?.trial_count;
    Some(format!(
        "after {trials} trials the Monte Carlo u is not stable in its first digit (JCGM 101, 7.9); \
         u and U are from the covariance. Set a larger monte_carlo_trials"
    ))
}

/// Text of a rotary position, e.g. `B -30°, C 90°`.
pub fn describe_rotary_position(position: &Position) -> String {
    let axes = position.iter().filter(|(axis, _)| !axis.is_linear());
    let named: Vec<String> = axes.map(|(axis, value)| format!("{axis} {:.0}°", axis.to_mm_or_deg(value))).collect();
    named.join(", ")
}
