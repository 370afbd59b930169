//! Warnings of the estimate.

use super::solution::GeometrySolution;
use crate::ball_measurement::tilts_table;
use crate::identification::{Identification, MisfitAdvice};
use machine::Position;
use machine::kinematics::{ErrorParameter, Shape};

const MISFIT_ADVICE: MisfitAdvice = MisfitAdvice {
    causes: "error motions, sag, drift or a loose ball",
    declared_by: "repeatability_um or error_motion_um",
};

pub fn warnings(solved: &GeometrySolution<'_>, identified: &Identification) -> Vec<String> {
    let mut lines = solved.observed.left_out.clone();
    lines.extend(misfit(solved, identified));
    lines.extend(solved.moved());
    lines.extend(identified.checked.warnings.iter().cloned());
    lines.extend(solved.length_disagreements());
    lines.extend(unsound_balls(solved));
    lines.extend(cold(solved));
    lines.extend(identified.trials_warning());
    lines.extend(unstable(identified));
    lines
}

/// Warning of a misfit, with the errors that a sag of the table would change.
fn misfit(solved: &GeometrySolution<'_>, identified: &Identification) -> Option<String> {
    let warning = identified.misfit_warning(&MISFIT_ADVICE)?;
    let is_above = identified.propagation.misfit.above;
    Some(if is_above { warning + &where_sag_goes(solved) } else { warning })
}

/// Sag follows the tilt: its effect resembles a rotation about the tilting axis, and offsets of the axes that
/// it carries.
fn where_sag_goes(solved: &GeometrySolution<'_>) -> String {
    let model = solved.problem.model();
    let table = model.chain().topology().workpiece();
    let Some(at) = table.iter().position(|axis| tilts_table(model.chain(), *axis)) else {
        return String::new();
    };
    let (tilting, carried) = (table[at], &table[at + 1..]);
    let takes = |error: &&ErrorParameter| {
        let offset = error.component().is_linear() && carried.contains(&error.axis());
        error.shape() == Shape::Location && (error.component() == tilting || offset)
    };
    let names: Vec<String> =
        model.parameters().iter().filter(takes).map(ToString::to_string).collect();
    if names.is_empty() {
        return String::new();
    }
    format!(". Sag of the table as {tilting} tilts it would stand in {}", names.join(", "))
}

/// Warnings of balls with a large form error, and of diameters that differ from the stated ones. The common
/// difference of all balls is pre-travel and is subtracted.
fn unsound_balls(solved: &GeometrySolution<'_>) -> Vec<String> {
    let sights = &solved.observed.centres;
    let stylus = solved.plan.probe.ball_radius_mm;
    let radius = |ball: usize| solved.balls.balls[ball].radius_mm + stylus;
    let short: Vec<f64> = sights.iter().map(|sight| sight.radius - radius(sight.ball)).collect();
    let mut sorted = short.clone();
    sorted.sort_by(f64::total_cmp);
    let common = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    let mut lines = Vec::new();
    for (sight, short) in sights.iter().zip(&short) {
        let (form_um, off_um) = (sight.form * 1e3, 2e3 * (short - common));
        let whose = format!("ball {} at indexation {}", sight.label.ball, sight.label.number());
        if form_um > solved.settings.form_limit_um {
            lines.push(format!(
                "{whose}: its form is {form_um:.1} µm: dirt, loose ball or wrong stylus?"
            ));
        }
        if off_um.abs() > solved.settings.diameter_limit_um {
            lines.push(format!(
                "{whose}: its diameter differs by {off_um:+.1} µm from the others: dirt, loose ball or \
                 wrong stylus?"
            ));
        }
    }
    lines
}

fn cold(solved: &GeometrySolution<'_>) -> Vec<String> {
    let unknown = solved
        .balls
        .lengths
        .iter()
        .filter(|length| length.expansion_um_per_m_k != 0.0 && length.temperature_c.is_none());
    let told = unknown.map(|length| {
        format!(
            "the temperature of the certified length {}–{} is not stated: 20 °C is assumed, to {} K (standard \
             uncertainty), and each kelvin makes {:.1} µm/m of all gains",
            length.from, length.to, length.u_temperature_k, length.expansion_um_per_m_k
        )
    });
    told.collect()
}

/// JCGM 101, 7.9: the maximum number of trials did not satisfy the stopping rule.
fn unstable(identified: &Identification) -> Option<String> {
    let trials = identified.trials.as_ref().filter(|trials| !trials.stable)?.trials;
    Some(format!(
        "after {trials} trials u by Monte Carlo is not yet stable in its first digit (JCGM 101, 7.9); u and \
         U are those by covariance. Ask for more by monte_carlo_trials"
    ))
}

/// Text of a rotary position, e.g. `B -30°, C 90°`.
pub fn place_name(position: &Position) -> String {
    let axes = position.iter().filter(|(axis, _)| !axis.is_linear());
    let named: Vec<String> =
        axes.map(|(axis, value)| format!("{axis} {:.0}°", axis.to_edge(value))).collect();
    named.join(", ")
}
