//! The estimate in the words and units of the contract.

use std::collections::BTreeSet;

use faer::{Mat, Side};
use nalgebra::Vector3;

use super::fit::{Problem, vector};
use super::harmonics;
use super::left_out::{LeftOut, in_words, left_out};
use super::parts::{Parts, place_name};
use super::suspects::{Outlier, Solved};
use super::warnings;
use estimation::coverage;
use machine::kinematics::{ErrorParameter, Shape};
use machine::record::artefact::Balls;
use machine::record::estimate::{
    Arrow, ArrowFigure, Arrows, BudgetLine, Covariance, ESTIMATE_VERSION, Estimate, Parameter,
    Unit, VectorKind, Verdict,
};
use machine::{Axis, Position};

/// Members of the least certain direction that are named, and how small a part still counts.
const NAMED: usize = 4;
const COUNTS: f64 = 0.3;

pub fn estimate(parts: &Parts<'_>) -> Estimate {
    let Solved { problem, minimum, .. } = parts.solved;
    let outliers = parts.solved.outliers();
    let misses = misses(parts);
    let square: f64 = misses.iter().map(|miss| miss.norm_squared()).sum();
    let dof = minimum.residuals.len().saturating_sub(problem.unknowns());
    let left_out = left_out(problem.model());
    Estimate {
        trued_estimate: ESTIMATE_VERSION,
        method: super::NAME.to_owned(),
        parameters: (0..problem.unknowns()).map(|i| parameter(parts, i)).collect(),
        functions: Vec::new(),
        circles: Vec::new(),
        arrows: vec![arrows(parts, &misses, &outliers)],
        covariance: covariance(parts),
        rank: parts.survey.rank,
        unknowns: problem.unknowns(),
        condition: parts.survey.condition,
        weakest: weakest(parts),
        gauge: gauge(parts, &left_out),
        not_identifiable: [in_words(&left_out), parts.solved.thin()].concat(),
        residual_rms_um: (square / (3 * misses.len()).max(1) as f64).sqrt() * 1e3,
        degrees_of_freedom: dof,
        chi2_per_dof: if dof > 0 { parts.misfit.chi2 / parts.misfit.expected } else { 0.0 },
        verdict: Verdict::None,
        warnings: warnings::warnings(parts, &outliers),
        priors: Vec::new(),
    }
}

/// Of all unknowns in their order: machine errors by their ISO names, stylus, balls.
pub fn names(problem: &Problem, balls: &Balls) -> Vec<String> {
    let mut names: Vec<String> =
        problem.model().parameters().iter().map(ToString::to_string).collect();
    let stylus = problem.model().stylus().iter();
    names.extend(stylus.map(|k| format!("tool_{}", ["x", "y", "z"][*k])));
    names.resize(problem.unknowns(), String::new());
    for (ball, named) in balls.balls.iter().enumerate() {
        for (k, axis) in ["x", "y", "z"].into_iter().enumerate() {
            names[problem.ball_at(ball) + k] = format!("ball_{}_{axis}", named.id);
        }
    }
    names
}

/// Lost directions, the one of the uniform scale by its own name.
pub fn lost_in_words(lines: Vec<String>) -> Vec<String> {
    let lines = lines.into_iter().map(|line| {
        let gains = ["EXX1", "EYY1", "EZZ1"].iter().filter(|name| line.contains(**name)).count();
        if gains > 1 {
            format!("the uniform scale, which a certified length would give: {line}")
        } else {
            line
        }
    });
    lines.collect()
}

fn unit(parts: &Parts<'_>, unknown: usize) -> Unit {
    let of_machine = |p: &ErrorParameter| match (p.shape(), p.component().is_linear()) {
        (Shape::Gain, _) => Unit::UmPerM,
        (_, true) => Unit::Um,
        (_, false) => Unit::Urad,
    };
    parts.solved.problem.model().parameters().get(unknown).map_or(Unit::Mm, of_machine)
}

fn parameter(parts: &Parts<'_>, i: usize) -> Parameter {
    let unit = unit(parts, i);
    let dof = parts.propagated.dof(i, &parts.misfit);
    let (k, u) = (coverage::coverage_factor(dof.unwrap_or(f64::INFINITY)), parts.propagated.u(i));
    let budget = parts.propagated.budget.iter().map(|(source, u)| BudgetLine {
        source: (*source).to_owned(),
        u: unit.from_internal(u[i]),
    });
    Parameter {
        symbol: parts.names[i].clone(),
        value: unit.from_internal(parts.solved.minimum.x[i]),
        unit,
        u: unit.from_internal(u),
        expanded: unit.from_internal(k * u),
        k,
        dof,
        identifiable: true,
        u_monte_carlo: Some(unit.from_internal(parts.monte_carlo.standard_deviation[i])),
        budget: budget.collect(),
    }
}

fn covariance(parts: &Parts<'_>) -> Covariance {
    let count = parts.names.len();
    let factor: Vec<f64> = (0..count).map(|i| unit(parts, i).from_internal(1.0)).collect();
    let full = &parts.propagated.covariance;
    let row = |i: usize| (0..count).map(|j| full[(i, j)] * factor[i] * factor[j]).collect();
    Covariance { symbols: parts.names.clone(), rows: (0..count).map(row).collect() }
}

/// Where the machine as found sees each ball, less where it is; table frame, mm.
fn misses(parts: &Parts<'_>) -> Vec<Vector3<f64>> {
    let Solved { problem, minimum, observed, .. } = parts.solved;
    let tips = problem.tips(&minimum.x, parts.measured);
    let ball = |ball| vector(&minimum.x, problem.ball_at(ball));
    observed.sights.iter().zip(tips).map(|(sight, tip)| tip - ball(sight.ball)).collect()
}

fn arrows(parts: &Parts<'_>, misses: &[Vector3<f64>], outliers: &[Outlier]) -> ArrowFigure {
    let Solved { problem, minimum, observed, balls } = parts.solved;
    let flagged: BTreeSet<usize> = outliers.iter().map(|outlier| outlier.sight).collect();
    let arrow = |i: usize| {
        let ball = observed.sights[i].ball;
        Arrow {
            label: balls.balls[ball].id.clone(),
            at_mm: vector(&minimum.x, problem.ball_at(ball)).into(),
            vector: (misses[i] * 1e3).into(),
            modelled: None,
            flagged: flagged.contains(&i),
        }
    };
    let group = |(place, position): (usize, &Position)| {
        let here = (0..misses.len()).filter(|i| observed.sights[*i].commanded == place);
        Arrows { name: place_name(position), arrows: here.map(arrow).collect() }
    };
    let groups = observed.commanded.iter().enumerate().map(group).collect();
    ArrowFigure {
        symbol: "residuals".to_owned(),
        unit: Unit::Um,
        groups,
        figure: VectorKind::Arrows,
    }
}

/// The direction in the scaled unknowns that the measurements see least.
fn weakest(parts: &Parts<'_>) -> Option<String> {
    let factored = &parts.solved.minimum.factored;
    let (covariance, norms) = (factored.covariance(), factored.column_norms());
    let count = norms.len();
    let scaled = Mat::from_fn(count, count, |i, j| covariance[(i, j)] * norms[i] * norms[j]);
    let eigen = scaled.self_adjoint_eigen(Side::Lower).ok()?;
    let direction = eigen.U().col(count.checked_sub(1)?);
    let mut members: Vec<usize> = (0..count).collect();
    members.sort_by(|a, b| direction[*b].abs().total_cmp(&direction[*a].abs()));
    let largest = direction[*members.first()?].abs();
    members.retain(|i| direction[*i].abs() > COUNTS * largest);
    members.truncate(NAMED);
    let names: Vec<&str> = members.iter().map(|i| parts.names[*i].as_str()).collect();
    Some(match names.as_slice() {
        [only] => format!("{only} alone"),
        [first, others @ ..] => format!("{first} together with {}", others.join(", ")),
        [] => return None,
    })
}

fn gauge(parts: &Parts<'_>, left_out: &[LeftOut]) -> Vec<String> {
    let model = parts.solved.problem.model();
    let told = left_out.iter().map(|left| left.error);
    let told: Vec<ErrorParameter> = told.chain(model.parameters().iter().copied()).collect();
    let held: Vec<String> = model
        .chain()
        .topology()
        .axes()
        .flat_map(|axis| Axis::ALL.map(|component| (component, axis)))
        .filter_map(|(component, axis)| ErrorParameter::new(component, axis, Shape::Location).ok())
        .filter(|error| !told.contains(error))
        .map(|error| error.to_string())
        .collect();
    let mut lines = vec![
        format!("held at zero, being other names for what is given: {}", held.join(", ")),
        "ball coordinates: the table frame of the machine as found, all rotary axes at zero"
            .to_owned(),
        "the machine as it stood in the middle of the measurement".to_owned(),
    ];
    let asked: Vec<String> = left_out.iter().filter_map(LeftOut::not_asked_for).collect();
    if !asked.is_empty() {
        lines.push(format!("held at zero, not asked for: {}", asked.join(", ")));
    }
    for k in (0..3).filter(|k| !model.stylus().contains(k)) {
        lines.push(format!(
            "tool_{} is held as stated: it only shifts all balls alike",
            ["x", "y", "z"][k]
        ));
    }
    if !model.chain().topology().contains(Axis::S) {
        lines.push(
            "tool_x and tool_y: an offset of the spindle (EX0S, EY0S) stands in them".to_owned(),
        );
    }
    if parts.lengths.iter().any(|length| length.temperature_c.is_some()) {
        lines.push("gains: against the certified length at its stated temperature".to_owned());
    }
    lines.extend(harmonics::in_words(model, &parts.solved.observed.commanded));
    lines
}
