//! Outputs of the method: reported quantities and figures.

use std::iter::{once, repeat};

use nalgebra::Vector3;

use super::centre_equations::{BEAM_DISTANCE_PER_READING_INDEX, BEAM_UNKNOWN_COUNT, gain_deviation};
use super::estimate_notes;
use super::latency::{LatencyEstimate, latency_unknown_names};
use super::pose_groups::PoseGroup;
use super::result::IdentificationResult;
use super::scan_purpose::describe_rotary_position;
use super::sphere_model::{MachineEquations, with_linear_axes};
use crate::ball_measurement::tilts_table;
use crate::identification::{IdentificationOutputs, OutputParameter, function_of_numbered_values, reported_unit};
use machine::record::estimate::{
    ArrowFigure, ArrowGroup, Estimate, EstimatedFunction, FigureArrow, FunctionFigureKind, Unit, VectorFigureKind,
};
use machine::{Axis, Position};

/// Outputs of the beam: tilt from its nominal direction along two perpendicular directions (X and Y for a beam that
/// points down), and deviation of the sensor's scale from 1.
const BEAM_OUTPUT_NAMES: [&str; BEAM_UNKNOWN_COUNT] = ["beam_x", "beam_y", "gain"];
const BEAM_OUTPUT_UNITS: [Unit; BEAM_UNKNOWN_COUNT] = [Unit::Urad, Unit::Urad, Unit::UmPerM];

pub fn build_estimate(result: &IdentificationResult<'_>) -> Estimate {
    let residuals = position_residuals(&result.machine_equations, &result.grouped.groups, &result.machine_fit.x);
    Estimate {
        functions: deviation_functions(result),
        arrows: vec![deviation_arrows(result, &residuals), arrow_figure(result, "residuals", &residuals, None)],
        gauge: estimate_notes::gauge_lines(result),
        held_at_zero: estimate_notes::held_location_errors(result),
        not_identifiable: estimate_notes::describe_not_identifiable(result),
        warnings: estimate_notes::estimate_warnings(result),
        ..result.identification.estimate(super::METHOD_NAME)
    }
}

/// Outputs for the unknowns `x`: machine, zero point and sphere (with `names`), then the beam, then the latency.
pub fn build_outputs(
    problem: &MachineEquations,
    names: &[String],
    latency: Option<&LatencyEstimate>,
    x: &[f64],
) -> IdentificationOutputs {
    let latency = latency.map_or_else(Vec::new, |latency| latency_unknown_names(&latency.moved_axes));
    let beam = x.len() - names.len() - latency.len();
    let errors = problem.model.parameters.iter().map(reported_unit);
    let machine_names = names.iter().cloned().zip(errors.chain(repeat(Unit::Mm)));
    let beam_names = BEAM_OUTPUT_NAMES.map(str::to_owned).into_iter().zip(BEAM_OUTPUT_UNITS).take(beam);
    let latency = latency.into_iter().zip(once(Unit::Ms).chain(repeat(Unit::Um)));
    let all = machine_names.chain(beam_names).chain(latency).enumerate();
    let parameters = all.map(|(i, (name, unit))| OutputParameter::from_unknown(&name, unit, i, x));
    let mut parameters: Vec<OutputParameter> = parameters.collect();
    if beam > BEAM_DISTANCE_PER_READING_INDEX {
        let gain = &mut parameters[names.len() + BEAM_DISTANCE_PER_READING_INDEX];
        gain.value = gain_deviation(gain.value);
        gain.linear_slope.iter_mut().flatten().for_each(|slope| *slope = -*slope);
    }
    IdentificationOutputs { linear_parameters: parameters, ..IdentificationOutputs::default() }
}

/// Position of the sphere on the machine with the errors in `x`, minus its estimated position: machine frame, mm.
pub fn position_residuals(problem: &MachineEquations, groups: &[PoseGroup], x: &[f64]) -> Vec<Vector3<f64>> {
    let centre_observations = problem.centre_observations.iter().zip(groups);
    centre_observations
        .map(|(observation, group)| group.machine_from_table * problem.model.misclosure(&observation.axis_positions, x))
        .collect()
}

/// Measured minus commanded position of the sphere at each pose, machine frame (paper 2, Fig. 9). The commanded
/// position follows from the positions of sphere and zero point on a machine without errors.
fn deviation_arrows(result: &IdentificationResult<'_>, residuals: &[Vector3<f64>]) -> ArrowFigure {
    let mut without = result.machine_fit.x.clone();
    without[..result.machine_equations.model.parameters.len()].fill(0.0);
    let total = position_residuals(&result.machine_equations, &result.grouped.groups, &without);
    let modelled: Vec<Vector3<f64>> = total.iter().zip(residuals).map(|(total, residual)| total - residual).collect();
    let figure = arrow_figure(result, "measured less commanded sphere", &total, Some(&modelled));
    ArrowFigure { figure: VectorFigureKind::Paths, ..figure }
}

/// Figure with one group of arrows for each position of the tilting axis, ordered by the angle of the turning axis.
fn arrow_figure(
    result: &IdentificationResult<'_>,
    symbol: &str,
    vectors: &[Vector3<f64>],
    modelled: Option<&[Vector3<f64>]>,
) -> ArrowFigure {
    let chain = &result.setup.chain;
    let tilting = |axis: Axis| tilts_table(chain, axis) && axis != Axis::S;
    let ball = result.machine_equations.model.ball_centre(&result.machine_fit.x);
    let mut groups: Vec<(Position, ArrowGroup)> = Vec::new();
    for i in pose_order(result, tilting) {
        let (group, vector) = (&result.grouped.groups[i], vectors[i]);
        let tilted = group.rotary.filter_axes(tilting);
        let table = chain.machine_from_table(&with_linear_axes(&group.rotary, Vector3::zeros()), &[]);
        let arrow = FigureArrow {
            label: describe_rotary_position(&group.rotary.filter_axes(|axis| !tilting(axis))),
            at_mm: table.transform_point(&ball.into()).coords.into(),
            vector: (vector * 1e3).into(),
            modelled: modelled.map(|all| (all[i] * 1e3).into()),
            flagged: false,
        };
        match groups.iter_mut().find(|(at, _)| *at == tilted) {
            Some((_, arrows)) => arrows.arrows.push(arrow),
            None => {
                let arrows = ArrowGroup { name: describe_rotary_position(&tilted), arrows: vec![arrow] };
                groups.push((tilted, arrows));
            }
        }
    }
    groups.sort_by(|(a, _), (b, _)| {
        let angle = |p: &Position| p.iter().next().map_or(0.0, |(_, value)| value);
        angle(a).total_cmp(&angle(b))
    });
    let groups = groups.into_iter().map(|(_, arrows)| arrows).collect();
    ArrowFigure { symbol: symbol.to_owned(), unit: Unit::Um, groups, figure: VectorFigureKind::Arrows }
}

/// Indices of the poses, ordered by the angle of the axis that turns the table.
fn pose_order(result: &IdentificationResult<'_>, tilting: impl Fn(Axis) -> bool) -> Vec<usize> {
    let groups = &result.grouped.groups;
    let turn_angle =
        |i: &usize| groups[*i].rotary.iter().find(|(axis, _)| !tilting(*axis)).map_or(0.0, |(_, angle)| angle);
    let mut order: Vec<usize> = (0..groups.len()).collect();
    order.sort_by(|a, b| turn_angle(a).total_cmp(&turn_angle(b)));
    order
}

/// Form error of each group of scans with one centre, in the order of the scans, and deviations of the points of all
/// scans from their spheres.
fn deviation_functions(result: &IdentificationResult<'_>) -> Vec<EstimatedFunction> {
    let points = result.grouped.centre_equations.surface_deviations_mm(&result.centre_fit.x);
    let deviations = function_of_numbered_values("deviation", "point", points.into_iter());
    vec![
        function_of_numbered_values("form", "pose", result.form_error_of_each_group_mm().into_iter()),
        EstimatedFunction { figure: FunctionFigureKind::Histogram, ..deviations },
    ]
}
