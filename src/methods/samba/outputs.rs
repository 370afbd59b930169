//! Builds the estimate of a solved run: all unknowns with the symbols and units in which the estimate reports them,
//! the residuals as arrows, and texts on what the run does not determine.

use std::collections::BTreeSet;

use faer::{Mat, Side};

use super::confounding::COORDINATE_NAMES;
use super::fit::vector_at;
use super::geometry_solution::GeometrySolution;
use super::omitted_errors::{OmittedError, describe_omitted_errors, omitted_errors};
use super::warnings::{self, describe_rotary_position};
use crate::identification::{
    Identification, IdentificationOutputs, OutputParameter, describe_aliased_orders, reported_unit,
};
use machine::kinematics::{ErrorParameter, ErrorShape};
use machine::record::estimate::{ArrowFigure, ArrowGroup, Estimate, FigureArrow, Unit, VectorFigureKind};
use machine::{Axis, Position};

/// Maximum number of named components of the least certain direction.
const MAX_NAMED_COMPONENTS: usize = 4;
/// Minimum size of a named component, relative to the largest component.
const MIN_NAMED_COMPONENT_RATIO: f64 = 0.3;

/// All unknowns as outputs.
pub fn build_outputs(solved: &GeometrySolution<'_>) -> IdentificationOutputs {
    let errors = solved.problem.model().parameters();
    let unit = |i: usize| errors.get(i).map_or(Unit::Mm, reported_unit);
    let names = solved.unknown_names.iter().enumerate();
    let all = names.map(|(i, name)| OutputParameter::from_unknown(name, unit(i), i, &solved.minimum.x));
    IdentificationOutputs { linear_parameters: all.collect(), ..IdentificationOutputs::default() }
}

pub fn build_estimate(solved: &GeometrySolution<'_>, identified: &Identification) -> Estimate {
    let omitted = omitted_errors(solved.problem.model());
    Estimate {
        arrows: vec![residual_arrows(solved, identified)],
        weakest: describe_weakest_direction(solved),
        gauge: describe_gauge(solved, &omitted),
        held_at_zero: redundant_location_errors(solved, &omitted),
        not_identifiable: describe_not_identifiable(solved, identified, &omitted),
        warnings: warnings::estimate_warnings(solved, identified),
        ..identified.estimate(super::METHOD_NAME)
    }
}

fn describe_not_identifiable(
    solved: &GeometrySolution<'_>,
    identified: &Identification,
    omitted: &[OmittedError],
) -> Vec<String> {
    let angles = |axis: Axis| -> Vec<f64> {
        solved.observed.commanded_rotary_positions.iter().map(|position| position.get_or_zero(axis)).collect()
    };
    let axes = solved.problem.model().chain().topology().axes();
    let rotary = axes.filter(|axis| !axis.is_linear());
    let locations = |axis: Axis| -> Vec<String> {
        let own = solved.problem.model().parameters().iter();
        let own = own.filter(|error| error.axis() == axis && error.shape() == ErrorShape::Location);
        own.map(ToString::to_string).collect()
    };
    let mut lines = [describe_omitted_errors(omitted), solved.describe_under_measured_balls()].concat();
    lines.extend(rotary.filter_map(|axis| match locations(axis) {
        names if names.is_empty() => None,
        names => describe_aliased_orders(axis, &angles(axis), &names.join(", ")),
    }));
    lines.extend(identified.outlier_check.describe_detection_limits());
    lines
}

fn residual_arrows(solved: &GeometrySolution<'_>, identified: &Identification) -> ArrowFigure {
    let GeometrySolution { problem, minimum, observed, balls, .. } = solved;
    let residuals = solved.position_residuals();
    let outliers = identified.outlier_check.outliers.iter().flat_map(|outlier| &outlier.candidates);
    let flagged: BTreeSet<&str> = outliers.map(|candidate| candidate.label.as_str()).collect();
    let arrow = |i: usize| {
        let ball = observed.centres[i].ball_index;
        FigureArrow {
            label: balls.balls[ball].id.clone(),
            at_mm: vector_at(&minimum.x, problem.ball_unknown_index(ball)).into(),
            vector: (residuals[i] * 1e3).into(),
            modelled: None,
            flagged: flagged.contains(observed.centres[i].label.measurement_label().as_str()),
        }
    };
    let group = |(index, position): (usize, &Position)| {
        let at_position =
            (0..residuals.len()).filter(|i| observed.centres[*i].commanded_rotary_position_index == index);
        ArrowGroup { name: describe_rotary_position(position), arrows: at_position.map(arrow).collect() }
    };
    let groups = observed.commanded_rotary_positions.iter().enumerate().map(group).collect();
    ArrowFigure { symbol: "residuals".to_owned(), unit: Unit::Um, groups, figure: VectorFigureKind::Arrows }
}

/// The direction in the scaled unknowns that the measurements determine least.
fn describe_weakest_direction(solved: &GeometrySolution<'_>) -> Option<String> {
    let factored = &solved.minimum.factorisation;
    let (covariance, norms) = (factored.covariance(), factored.column_norms());
    let count = norms.len();
    let scaled = Mat::from_fn(count, count, |i, j| covariance[(i, j)] * norms[i] * norms[j]);
    let eigen = scaled.self_adjoint_eigen(Side::Lower).ok()?;
    let direction = eigen.U().col(count.checked_sub(1)?);
    let mut members: Vec<usize> = (0..count).collect();
    members.sort_by(|a, b| direction[*b].abs().total_cmp(&direction[*a].abs()));
    let largest = direction[*members.first()?].abs();
    members.retain(|i| direction[*i].abs() > MIN_NAMED_COMPONENT_RATIO * largest);
    members.truncate(MAX_NAMED_COMPONENTS);
    let names: Vec<&str> = members.iter().map(|i| solved.unknown_names[*i].as_str()).collect();
    Some(match names.as_slice() {
        [name] => format!("{name} alone"),
        [first, others @ ..] => format!("{first} together with {}", others.join(", ")),
        [] => return None,
    })
}

/// Names of the location errors that are equivalent to reported errors: those that are neither identified nor in
/// `omitted`.
fn redundant_location_errors(solved: &GeometrySolution<'_>, omitted: &[OmittedError]) -> Vec<String> {
    let model = solved.problem.model();
    let reported = omitted.iter().map(|omitted| omitted.error);
    let reported: Vec<ErrorParameter> = reported.chain(model.parameters().iter().copied()).collect();
    model
        .chain()
        .topology()
        .axes()
        .flat_map(|axis| Axis::ALL.map(|component| (component, axis)))
        .filter_map(|(component, axis)| ErrorParameter::new(component, axis, ErrorShape::Location).ok())
        .filter(|error| !reported.contains(error))
        .map(|error| error.to_string())
        .collect()
}

fn describe_gauge(solved: &GeometrySolution<'_>, omitted: &[OmittedError]) -> Vec<String> {
    let model = solved.problem.model();
    let mut lines = vec![
        format!(
            "held at zero, because equivalent to reported errors: {}",
            redundant_location_errors(solved, omitted).join(", ")
        ),
        "ball coordinates: in the table frame of the identified machine, all rotary axes at zero".to_owned(),
        "the result describes the machine at the middle of the measurement".to_owned(),
    ];
    let unrequested: Vec<String> = omitted.iter().filter_map(OmittedError::unrequested_name).collect();
    if !unrequested.is_empty() {
        lines.push(format!("held at zero, because not requested: {}", unrequested.join(", ")));
    }
    for k in (0..3).filter(|k| !model.free_stylus_coordinates().contains(k)) {
        lines.push(format!("tool_{} keeps its stated value: it only shifts all balls equally", COORDINATE_NAMES[k]));
    }
    if !model.chain().topology().contains(Axis::S) {
        lines.push("tool_x and tool_y include the offset of the spindle (EX0S, EY0S)".to_owned());
    }
    if solved.balls.lengths.iter().any(|length| length.temperature_c.is_some()) {
        lines.push("gains: relative to the certified length at its stated temperature".to_owned());
    }
    lines
}
