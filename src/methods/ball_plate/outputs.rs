//! Reported quantities: harmonics, curves of the six error motions, the plate, the linear axes.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3};

use super::angle_basis::equal_angles;
use super::solved::SolvedRun;
use super::unknowns_layout::{DirectionAtBall, MOTION_COMPONENTS};
use crate::identification::{
    Harmonic, HarmonicFunction, IdentificationOutputs, OutputCurve, OutputParameter, RangeOutput, range_outputs,
    slope_of_unknown,
};
use machine::Axis;
use machine::record::estimate::{FunctionFigureKind, Unit};

/// Number of points of a curve per revolution.
const CURVE_POINTS_PER_REVOLUTION: usize = 72;

/// Linear parameters; curves of the six error motions, the plate and the linear axes, in this order; and, as
/// nonlinear outputs, the range of each error motion over its curve.
pub fn build_outputs(solved: &SolvedRun<'_>) -> IdentificationOutputs {
    let motions = MOTION_COMPONENTS.iter().enumerate().map(|(k, component)| error_motion_curve(solved, k, *component));
    let motions: Vec<OutputCurve> = motions.collect();
    let range = |motion: &OutputCurve| RangeOutput {
        symbol: format!("{}_range", motion.symbol),
        unit: motion.unit,
        slopes: motion.slopes.clone(),
    };
    let ranges = motions.iter().map(range).collect();
    let curves = motions.into_iter().chain(ball_deviation_curves(solved)).chain(linear_axis_deviation_curves(solved));
    IdentificationOutputs {
        linear_parameters: build_parameters(solved),
        curves: curves.collect(),
        nonlinear: Some(range_outputs(ranges, &solved.solution.x)),
    }
}

/// Harmonics of each error motion; empty if each stop has a separate value.
pub fn harmonic_functions(solved: &SolvedRun<'_>) -> Vec<HarmonicFunction> {
    let (layout, axis) = (&solved.design.layout, solved.plate.rotary_axis);
    let unknowns = layout.unknown_count();
    let harmonic = |k: usize, (pair, order): (usize, f64)| {
        let part = |function| slope_of_unknown(layout.motion_unknown_index(k, 2 * pair + function), unknowns);
        Harmonic { order, cosine_and_sine_slopes: [part(0), part(1)] }
    };
    let function = |(k, component): (usize, Axis)| HarmonicFunction {
        symbol: format!("E{component}{axis}"),
        unit: component_unit(component),
        harmonics: layout.angle_basis.periods_per_revolution().enumerate().map(|pair| harmonic(k, pair)).collect(),
    };
    let functions = MOTION_COMPONENTS.into_iter().enumerate().map(function);
    functions.filter(|function| !function.harmonics.is_empty()).collect()
}

pub fn component_unit(component: Axis) -> Unit {
    if component.is_linear() { Unit::Um } else { Unit::Urad }
}

/// Harmonics and reversal of each component, then eccentricity and tilt of the plate.
fn build_parameters(solved: &SolvedRun<'_>) -> Vec<OutputParameter> {
    let (layout, axis, x) = (&solved.design.layout, solved.plate.rotary_axis, &solved.solution.x);
    // Separate values at the stops are reported as points of the curves, not as parameters.
    let function_suffixes =
        if solved.settings.value_per_stop { Vec::new() } else { layout.angle_basis.function_suffixes() };
    let mut parameters = Vec::new();
    for (k, component) in MOTION_COMPONENTS.into_iter().enumerate() {
        for (function, suffix) in function_suffixes.iter().enumerate() {
            let symbol = format!("E{component}{axis}_{suffix}");
            let index = layout.motion_unknown_index(k, function);
            parameters.push(OutputParameter::from_unknown(&symbol, component_unit(component), index, x));
        }
        if layout.has_reversal {
            let symbol = format!("E{component}{axis}_reversal");
            parameters.push(OutputParameter::from_unknown(
                &symbol,
                component_unit(component),
                layout.reversal_unknown_index(k),
                x,
            ));
        }
    }
    parameters.extend(plate_alignment_outputs(solved));
    parameters
}

/// Offset of the circle of the balls from the axis, and slope of its plane, table frame.
fn plate_alignment_outputs(solved: &SolvedRun<'_>) -> Vec<OutputParameter> {
    let (layout, plate, x) = (&solved.design.layout, solved.plate, &solved.solution.x);
    let circle = first_harmonic_fit_weights(&plate.radial_directions);
    let plane = circle.iter().map(|row| row.map(|weight| weight / plate.circle_radius_mm));
    let plane: Vec<[f64; 2]> = plane.collect();
    let from_axis: Vec<Vector3<f64>> =
        solved.measured.first_measured_centres_mm.iter().map(|at| at - plate.axis_point_mm).collect();
    let output = |symbol: &str, unit: Unit, weights: &[[f64; 2]], axis: usize, direction: DirectionAtBall| {
        let mut slope = vec![0.0; x.len()];
        let mut stated = 0.0;
        for (ball, radial) in plate.radial_directions.iter().enumerate() {
            let along = direction(radial);
            (0..3).for_each(|k| slope[layout.ball_unknown_index(ball, k)] = weights[ball][axis] * along[k]);
            stated += weights[ball][axis] * along.dot(&from_axis[ball]);
        }
        let mut output = OutputParameter::from_coefficients(symbol, unit, slope, x);
        output.value += stated;
        output
    };
    vec![
        output("e_x", Unit::Um, &circle, 0, |radial| *radial),
        output("e_y", Unit::Um, &circle, 1, |radial| *radial),
        output("dz_dx", Unit::Urad, &plane, 0, |_| Vector3::z()),
        output("dz_dy", Unit::Urad, &plane, 1, |_| Vector3::z()),
    ]
}

/// Least-squares fit of a quantity over the balls as a·cos + b·sin + constant of their azimuth: weights of
/// the value at each ball in a and b.
fn first_harmonic_fit_weights(radial: &[Vector3<f64>]) -> Vec<[f64; 2]> {
    let row = |r: &Vector3<f64>| Vector3::new(r.x, r.y, 1.0);
    let normal: Matrix3<f64> = radial.iter().map(|r| row(r) * row(r).transpose()).sum();
    let inverse = normal.try_inverse().unwrap_or(Matrix3::zeros());
    let weights = |r: &Vector3<f64>| inverse * row(r);
    radial.iter().map(weights).map(|w| [w.x, w.y]).collect()
}

/// Curve of one error motion, mean of both directions without the reversal. `k`: index of the component.
fn error_motion_curve(solved: &SolvedRun<'_>, k: usize, component: Axis) -> OutputCurve {
    let (layout, axis, x) = (&solved.design.layout, solved.plate.rotary_axis, &solved.solution.x);
    let slope = |(stop, angle): (usize, &f64)| {
        let mut slope = vec![0.0; x.len()];
        for (function, value) in layout.angle_basis.function_values(*angle, stop).into_iter().enumerate() {
            slope[layout.motion_unknown_index(k, function)] = value;
        }
        slope
    };
    let angles: Vec<f64> = match solved.settings.value_per_stop {
        true => solved.design.stops.iter().map(|stop| stop.angle).collect(),
        false => {
            // A sub-harmonic repeats after several revolutions.
            let turns = if layout.angle_basis.has_sub_harmonics() { solved.settings.revolutions } else { 1 };
            let points = 0..=CURVE_POINTS_PER_REVOLUTION * turns;
            points.map(|i| TAU * i as f64 / CURVE_POINTS_PER_REVOLUTION as f64).collect()
        }
    };
    let slopes: Vec<Vec<f64>> = angles.iter().enumerate().map(slope).collect();
    OutputCurve {
        symbol: format!("E{component}{axis}"),
        argument: axis.name(),
        argument_unit: "deg",
        x: angles.iter().map(|angle| angle.to_degrees()).collect(),
        y: curve_values(&slopes, x),
        unit: component_unit(component),
        figure: FunctionFigureKind::Polar,
        slopes,
    }
}

fn curve_values(slopes: &[Vec<f64>], x: &[f64]) -> Vec<f64> {
    slopes.iter().map(|slope| slope.iter().zip(x).map(|(slope, x)| slope * x).sum()).collect()
}

/// Deviation of each ball from its position in the first measurement with the nominal machine: radial,
/// tangential, axial components.
fn ball_deviation_curves(solved: &SolvedRun<'_>) -> impl Iterator<Item = OutputCurve> {
    let (layout, plate, x) = (&solved.design.layout, solved.plate, &solved.solution.x);
    let directions: [(&str, DirectionAtBall); 3] = [
        ("plate_radial", |radial| *radial),
        ("plate_tangential", |radial| Vector3::z().cross(radial)),
        ("plate_axial", |_| Vector3::z()),
    ];
    directions.into_iter().map(move |(symbol, direction)| {
        let slope = |(ball, radial): (usize, &Vector3<f64>)| {
            let mut slope = vec![0.0; x.len()];
            let along = direction(radial);
            (0..3).for_each(|axis| slope[layout.ball_unknown_index(ball, axis)] = along[axis]);
            slope
        };
        let slopes: Vec<Vec<f64>> = plate.radial_directions.iter().enumerate().map(slope).collect();
        OutputCurve {
            symbol: symbol.to_owned(),
            argument: "ball",
            argument_unit: "",
            x: (1..=slopes.len()).map(|number| number as f64).collect(),
            y: curve_values(&slopes, x),
            unit: Unit::Um,
            figure: FunctionFigureKind::Points,
            slopes,
        }
    })
}

/// True minus displayed position of each linear axis at the measuring positions, within the gauge.
fn linear_axis_deviation_curves(solved: &SolvedRun<'_>) -> impl Iterator<Item = OutputCurve> {
    let (layout, x) = (&solved.design.layout, &solved.solution.x);
    Axis::LINEAR.into_iter().enumerate().map(move |(k, axis)| {
        let slope = |place: usize| slope_of_unknown(layout.measuring_position_unknown_index(place, k), x.len());
        let slopes: Vec<Vec<f64>> = (0..layout.measuring_position_count).map(slope).collect();
        OutputCurve {
            symbol: format!("D{axis}"),
            argument: "position",
            argument_unit: "deg",
            x: equal_angles(layout.measuring_position_count).map(f64::to_degrees).collect(),
            y: curve_values(&slopes, x),
            unit: Unit::Um,
            figure: FunctionFigureKind::Points,
            slopes,
        }
    })
}
