//! What a reader of the estimate must know beside its numbers.

use super::parameters::tilts_table;
use super::parts::{Parts, place_name};
use super::suspects::Outlier;
use machine::kinematics::{ErrorParameter, Shape};

pub fn warnings(parts: &Parts<'_>, outliers: &[Outlier]) -> Vec<String> {
    let mut lines = parts.solved.observed.left_out.clone();
    lines.extend(misfit(parts));
    lines.extend(parts.solved.moved());
    lines.extend(outliers.iter().map(|outlier| far_off(parts, outlier)));
    lines.extend(parts.solved.lengths(parts.lengths, parts.u_bars));
    lines.extend(unsound_balls(parts));
    lines.extend(cold(parts));
    lines.extend(disagreement(parts));
    lines.extend(unstable(parts));
    lines
}

fn misfit(parts: &Parts<'_>) -> Option<String> {
    let misfit = &parts.misfit;
    if misfit.above {
        return Some(format!(
            "the model does not explain the measurements: they scatter {:.1} times more than declared \
             ({}); look for error motions, sag, drift or a loose ball. The \
             uncertainties are enlarged by that factor, which need not cover what the model does not hold{}",
            misfit.factor,
            against_expectation(parts),
            where_sag_goes(parts)
        ));
    }
    misfit.below.then(|| {
        format!(
            "the measurements scatter less than declared ({}): \
             repeatability_um or error_motion_um may be stated too large, and the uncertainties with it",
            against_expectation(parts)
        )
    })
}

/// Sag follows the tilt: it looks like turning about the tilting axis, and like offsets of what it
/// carries.
fn where_sag_goes(parts: &Parts<'_>) -> String {
    let model = parts.solved.problem.model();
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

/// χ² and what it is on average where all is as declared.
fn against_expectation(parts: &Parts<'_>) -> String {
    let (chi2, expected) = (parts.misfit.chi2, parts.misfit.expected);
    let solved = &parts.solved;
    let dof = solved.minimum.residuals.len().saturating_sub(solved.problem.unknowns());
    let mut told = format!("χ² {chi2:.0} where {expected:.0} is expected");
    if (expected - dof as f64).abs() >= 0.5 {
        told += &format!(
            ", not the {dof} degrees of freedom: what is declared to move many measurements together \
             leaves other residuals than what moves each alone"
        );
    }
    told
}

fn far_off(parts: &Parts<'_>, outlier: &Outlier) -> String {
    let observed = parts.solved.observed;
    let sight = &observed.sights[outlier.sight];
    format!(
        "ball {} at indexation {} ({}) is {:.1} standard deviations off the rest: dirt, loose ball or \
         wrong stylus? It is kept; flag its readings `excluded` to leave it out",
        sight.label.ball,
        sight.label.number(),
        place_name(&observed.commanded[sight.commanded]),
        outlier.t
    )
}

/// Spheres that are none, and diameters that differ: from the stated ones, less what all have in
/// common, which is pre-travel.
fn unsound_balls(parts: &Parts<'_>) -> Vec<String> {
    let sights = &parts.solved.observed.sights;
    let stylus = parts.plan.probe.ball_radius_mm;
    let radius = |ball: usize| parts.solved.balls.balls[ball].radius_mm + stylus;
    let short: Vec<f64> = sights.iter().map(|sight| sight.radius - radius(sight.ball)).collect();
    let mut sorted = short.clone();
    sorted.sort_by(f64::total_cmp);
    let common = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    let mut lines = Vec::new();
    for (sight, short) in sights.iter().zip(&short) {
        let (form_um, off_um) = (sight.form * 1e3, 2e3 * (short - common));
        let whose = format!("ball {} at indexation {}", sight.label.ball, sight.label.number());
        if form_um > parts.settings.form_limit_um {
            lines.push(format!(
                "{whose}: its form is {form_um:.1} µm: dirt, loose ball or wrong stylus?"
            ));
        }
        if off_um.abs() > parts.settings.diameter_limit_um {
            lines.push(format!(
                "{whose}: its diameter differs by {off_um:+.1} µm from the others: dirt, loose ball or \
                 wrong stylus?"
            ));
        }
    }
    lines
}

fn cold(parts: &Parts<'_>) -> Vec<String> {
    let unknown = parts
        .lengths
        .iter()
        .filter(|length| length.expansion_um_per_m_k != 0.0 && length.temperature_c.is_none());
    let told = unknown.map(|length| {
        format!(
            "the temperature of the certified length {}–{} is not stated: 20 °C is assumed, and each \
             kelvin makes {:.1} µm/m of all gains",
            length.from, length.to, length.expansion_um_per_m_k
        )
    });
    told.collect()
}

/// JCGM 101, 7.9: the trials were as many as may be, and not enough for their stopping rule.
fn unstable(parts: &Parts<'_>) -> Option<String> {
    let told = || {
        format!(
            "after {} trials u by Monte Carlo is not yet stable in its first digit (JCGM 101, 7.9); u and \
             U are those by covariance. Ask for more by monte_carlo_trials",
            parts.monte_carlo.trials
        )
    };
    (!parts.monte_carlo.stable).then(told)
}

/// Where covariance and Monte Carlo differ.
fn disagreement(parts: &Parts<'_>) -> Vec<String> {
    let far = parts.names.iter().enumerate();
    let far = far.filter(|(i, _)| parts.monte_carlo.contradicts(*i, parts.propagated.u(*i)));
    let names: Vec<&str> = far.map(|(_, name)| name.as_str()).collect();
    if names.is_empty() {
        return Vec::new();
    }
    vec![format!("u by covariance and by Monte Carlo disagree: {}", names.join(", "))]
}
