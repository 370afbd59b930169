//! Outputs: axis position and error motions, as linear functions of the unknowns.
//!
//! With the sphere's centre b relative to the nominal axis, R the rotation of the table and w the displacement of
//! the sphere relative to the nest, the nest is displaced by E_total(C) = (I − R)b − R·w(C) relative to a rotation
//! about the nominal axis. Self-calibration reports the same quantity (METHODS section 1), so the two can be
//! compared.

use machine::record::estimate::{FunctionFigureKind, Unit};
use nalgebra::Matrix3;

use super::model::SensorEquations;
use crate::identification::{IdentificationOutputs, OutputCurve, OutputParameter, RangeOutput, range_outputs};

/// Derivatives by each unknown, for X, Y and Z.
type XyzDerivatives = [Vec<f64>; 3];

pub fn build_outputs(equation: &SensorEquations<'_>, x: &[f64]) -> IdentificationOutputs {
    let stops = equation.unknowns.stop_count;
    let totals: Vec<XyzDerivatives> = (0..stops).map(|stop| total_displacement_derivatives(equation, stop)).collect();
    let mean = mean_derivatives(&totals);
    let motions: Vec<XyzDerivatives> =
        totals.iter().enumerate().map(|(stop, total)| error_motion_derivatives(equation, stop, total, &mean)).collect();
    let axis = equation.nest.measured_axis;
    let location = |k: usize, along: &str| {
        OutputParameter::from_coefficients(&format!("E{along}0{axis}"), Unit::Um, mean[k].clone(), x)
    };
    let curve = |symbol: String, k: usize, all: &[XyzDerivatives], figure| {
        let slopes: Vec<Vec<f64>> = all.iter().map(|slopes| slopes[k].clone()).collect();
        let value = |slope: &Vec<f64>| slope.iter().zip(x).map(|(s, x)| s * x).sum();
        OutputCurve {
            symbol,
            argument: axis.name(),
            argument_unit: "deg",
            x: (0..stops).map(|stop| stop as f64 * 360.0 / stops as f64).collect(),
            y: slopes.iter().map(value).collect(),
            unit: Unit::Um,
            figure,
            slopes,
        }
    };
    let names = ["X", "Y", "Z"].into_iter().enumerate();
    let total = |k: usize, along: &str| curve(format!("E{along}{axis}_total"), k, &totals, FunctionFigureKind::Curve);
    let mut curves = vec![total(0, "X"), total(1, "Y")];
    curves.extend(
        names.clone().map(|(k, along)| curve(format!("E{along}{axis}"), k, &motions, FunctionFigureKind::Polar)),
    );
    let ranges = names.map(|(k, along)| RangeOutput {
        symbol: format!("E{along}{axis}_range"),
        unit: Unit::Um,
        slopes: motions.iter().map(|slopes| slopes[k].clone()).collect(),
    });
    IdentificationOutputs {
        linear_parameters: vec![location(0, "X"), location(1, "Y")],
        curves,
        nonlinear: Some(range_outputs(ranges.collect(), x)),
    }
}

/// Derivatives of E_total at a stop: displacement of the nest relative to a rotation about the nominal axis, machine
/// frame.
fn total_displacement_derivatives(equation: &SensorEquations<'_>, stop: usize) -> XyzDerivatives {
    let SensorEquations { nest, unknowns, .. } = equation;
    let turn = nest.machine_from_table(nest.stop_angle_rad(stop)).into_inner();
    let lever = Matrix3::identity() - turn;
    let mut slopes = [(); 3].map(|()| vec![0.0; unknowns.unknown_count()]);
    for (k, slope) in slopes.iter_mut().enumerate() {
        for i in 0..2 {
            slope[unknowns.sphere_position_index() + i] = lever[(k, i)];
        }
        if let Some(first) = unknowns.stop_displacement_index(stop) {
            (0..3).for_each(|i| slope[first + i] = -turn[(k, i)]);
        }
    }
    slopes
}

/// Mean over all stops: the axis position in X and Y.
fn mean_derivatives(totals: &[XyzDerivatives]) -> XyzDerivatives {
    [0, 1, 2].map(|k| {
        let mut mean = vec![0.0; totals.first().map_or(0, |slopes| slopes[k].len())];
        for slopes in totals {
            mean.iter_mut().zip(&slopes[k]).for_each(|(m, s)| *m += s / totals.len() as f64);
        }
        mean
    })
}

/// The error motion: X and Y without the effect of the axis position, Z without its mean.
fn error_motion_derivatives(
    equation: &SensorEquations<'_>,
    stop: usize,
    total: &XyzDerivatives,
    mean: &XyzDerivatives,
) -> XyzDerivatives {
    let turn = equation.nest.machine_from_table(equation.nest.stop_angle_rad(stop)).into_inner();
    let lever = Matrix3::identity() - turn;
    let mut motion = total.clone();
    for (k, slope) in motion.iter_mut().enumerate() {
        for (j, slope) in slope.iter_mut().enumerate() {
            *slope -= if k == 2 { mean[2][j] } else { lever[(k, 0)] * mean[0][j] + lever[(k, 1)] * mean[1][j] };
        }
    }
    motion
}
