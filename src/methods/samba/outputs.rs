//! Results of the estimate, in the symbols and units of its contract.

use std::collections::BTreeSet;

use faer::{Mat, Side};

use super::fit::vector;
use super::left_out::{LeftOut, in_words, left_out};
use super::solution::GeometrySolution;
use super::warnings::{self, place_name};
use crate::identification::{Identification, Output, Outputs, aliased, reported_unit};
use machine::kinematics::{ErrorParameter, Shape};
use machine::record::estimate::{Arrow, ArrowFigure, Arrows, Estimate, Unit, VectorKind};
use machine::{Axis, Position};

/// Maximum number of named components of the least certain direction (`NAMED`), and minimum size of a
/// component (`COUNTS`).
const NAMED: usize = 4;
const COUNTS: f64 = 0.3;

/// All unknowns as outputs.
pub fn outputs(solved: &GeometrySolution<'_>) -> Outputs {
    let errors = solved.problem.model().parameters();
    let unit = |i: usize| errors.get(i).map_or(Unit::Mm, reported_unit);
    let names = solved.names.iter().enumerate();
    let all = names.map(|(i, name)| Output::unknown(name, unit(i), i, &solved.minimum.x));
    Outputs { parameters: all.collect(), ..Outputs::default() }
}

pub fn estimate(solved: &GeometrySolution<'_>, identified: &Identification) -> Estimate {
    let left_out = left_out(solved.problem.model());
    Estimate {
        arrows: vec![arrows(solved, identified)],
        weakest: weakest(solved),
        gauge: gauge(solved, &left_out),
        not_identifiable: not_identifiable(solved, identified, &left_out),
        warnings: warnings::warnings(solved, identified),
        ..identified.estimate(super::NAME)
    }
}

fn not_identifiable(
    solved: &GeometrySolution<'_>,
    identified: &Identification,
    left_out: &[LeftOut],
) -> Vec<String> {
    let angles = |axis: Axis| -> Vec<f64> {
        solved.observed.commanded.iter().map(|place| place.at(axis)).collect()
    };
    let axes = solved.problem.model().chain().topology().axes();
    let rotary = axes.filter(|axis| !axis.is_linear());
    let locations = |axis: Axis| -> Vec<String> {
        let own = solved.problem.model().parameters().iter();
        let own = own.filter(|error| error.axis() == axis && error.shape() == Shape::Location);
        own.map(ToString::to_string).collect()
    };
    let mut lines = [in_words(left_out), solved.thin()].concat();
    lines.extend(rotary.filter_map(|axis| match locations(axis) {
        none if none.is_empty() => None,
        names => aliased(axis, &angles(axis), &names.join(", ")),
    }));
    lines.extend(identified.checked.limits());
    lines
}

fn arrows(solved: &GeometrySolution<'_>, identified: &Identification) -> ArrowFigure {
    let GeometrySolution { problem, minimum, observed, balls, .. } = solved;
    let misses = solved.misses();
    let outliers = identified.checked.outliers.iter().flat_map(|outlier| &outlier.candidates);
    let flagged: BTreeSet<&str> = outliers.map(|candidate| candidate.label.as_str()).collect();
    let arrow = |i: usize| {
        let ball = observed.centres[i].ball;
        Arrow {
            label: balls.balls[ball].id.clone(),
            at_mm: vector(&minimum.x, problem.ball_at(ball)).into(),
            vector: (misses[i] * 1e3).into(),
            modelled: None,
            flagged: flagged.contains(observed.centres[i].label.measurement().as_str()),
        }
    };
    let group = |(place, position): (usize, &Position)| {
        let here = (0..misses.len()).filter(|i| observed.centres[*i].commanded == place);
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

/// The direction in the scaled unknowns that the measurements determine least.
fn weakest(solved: &GeometrySolution<'_>) -> Option<String> {
    let factored = &solved.minimum.factored;
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
    let names: Vec<&str> = members.iter().map(|i| solved.names[*i].as_str()).collect();
    Some(match names.as_slice() {
        [only] => format!("{only} alone"),
        [first, others @ ..] => format!("{first} together with {}", others.join(", ")),
        [] => return None,
    })
}

fn gauge(solved: &GeometrySolution<'_>, left_out: &[LeftOut]) -> Vec<String> {
    let model = solved.problem.model();
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
    if solved.balls.lengths.iter().any(|length| length.temperature_c.is_some()) {
        lines.push("gains: against the certified length at its stated temperature".to_owned());
    }
    lines
}
