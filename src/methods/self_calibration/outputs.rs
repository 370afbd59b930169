//! Outputs as linear combinations of the unknowns: axis position, tilts, scale difference, squareness, and the
//! functions of angle.

use super::model::UnknownsLayout;
use crate::identification::{
    IdentificationOutputs, OutputCurve, OutputParameter, dot_product, linear_combination, slope_of_unknown,
};
use machine::Axis;
use machine::record::estimate::{FunctionFigureKind, Unit};

/// All outputs. `rotary_axis`: the measured axis.
pub fn build_outputs(layout: &UnknownsLayout, rotary_axis: Axis, heights: &[f64], x: &[f64]) -> IdentificationOutputs {
    let suffix = |height: usize| match heights.len() {
        1 => String::new(),
        _ => format!("@Z{:.1}", heights[height]),
    };
    let curves = |height| build_curves(layout, rotary_axis, height, &suffix(height), x);
    IdentificationOutputs {
        linear_parameters: build_parameters(layout, rotary_axis, heights, x),
        curves: (0..layout.height_count).flat_map(curves).collect(),
        nonlinear: None,
    }
}

/// Axis position, tilts, scale difference and squareness. `z` are the heights in the machine
/// frame, mm.
fn build_parameters(layout: &UnknownsLayout, rotary_axis: Axis, z: &[f64], x: &[f64]) -> Vec<OutputParameter> {
    let heights = layout.height_count as f64;
    let radius = (0..layout.height_count).map(|h| x[layout.radius_index(h)]).sum::<f64>() / heights;
    let output = |symbol: &str, unit, columns: &[Vec<f64>], weights: &[f64]| {
        OutputParameter::from_coefficients(symbol, unit, linear_combination(columns, weights), x)
    };
    let location = |component| format!("E{component}0{rotary_axis}");
    let equal_weights = vec![1.0 / heights; layout.height_count];
    let position = |height| axis_position_coefficients(layout, height);
    let (position_x, position_y): (Vec<_>, Vec<_>) = (0..layout.height_count).map(position).unzip();
    let mut list = vec![
        output(&location("X"), Unit::Um, &position_x, &equal_weights),
        output(&location("Y"), Unit::Um, &position_y, &equal_weights),
    ];
    let mean = z.iter().sum::<f64>() / heights;
    let spread: f64 = z.iter().map(|value| (value - mean).powi(2)).sum();
    if layout.height_count > 1 && spread > 0.0 {
        // A tilt a about X moves the axis by −a·z in Y, a tilt b about Y by +b·z in X.
        let about_y: Vec<f64> = z.iter().map(|z| (z - mean) / spread).collect();
        let about_x: Vec<f64> = about_y.iter().map(|weight| -weight).collect();
        list.push(output(&location("A"), Unit::Urad, &position_y, &about_x));
        list.push(output(&location("B"), Unit::Urad, &position_x, &about_y));
    }
    let linear_errors = |height| scale_and_squareness_coefficients(layout, height, radius);
    let (scale, squareness): (Vec<_>, Vec<_>) = (0..layout.height_count).map(linear_errors).unzip();
    list.push(output("EYY1-EXX1", Unit::UmPerM, &scale, &equal_weights));
    list.push(output("EC0Y", Unit::Urad, &squareness, &equal_weights));
    list
}

/// The functions of one height.
fn build_curves(
    layout: &UnknownsLayout,
    rotary_axis: Axis,
    height: usize,
    suffix: &str,
    x: &[f64],
) -> Vec<OutputCurve> {
    let n = layout.design.angle_count;
    let unit_vector = |index: usize| slope_of_unknown(index, layout.unknown_count());
    let motion = |i, along_y| error_motion_coefficients(layout, height, i, along_y);
    let function = |symbol: &str, argument, figure, point: &dyn Fn(usize) -> Vec<f64>| {
        let slopes: Vec<Vec<f64>> = (0..n).map(point).collect();
        OutputCurve {
            symbol: format!("{symbol}{suffix}"),
            argument,
            argument_unit: "deg",
            x: (0..n).map(|i| rad_to_rounded_deg(layout.design.grid_angle_rad(i))).collect(),
            y: slopes.iter().map(|slope| dot_product(slope, x)).collect(),
            unit: Unit::Um,
            figure,
            slopes,
        }
    };
    let of_axis = |component, what| format!("E{component}{rotary_axis}{what}");
    let name = rotary_axis.name();
    use FunctionFigureKind::{Curve as Line, Polar};
    vec![
        function(&of_axis("X", "_total"), name, Line, &|i| unit_vector(layout.ex_index(height, i))),
        function(&of_axis("Y", "_total"), name, Line, &|i| unit_vector(layout.ey_index(height, i))),
        function(&of_axis("X", ""), name, Line, &|i| motion(i, false)),
        function(&of_axis("Y", ""), name, Line, &|i| motion(i, true)),
        function("E_radial_XY", "phi", Line, &|i| unit_vector(layout.linear_axes_radial_error_index(height, i))),
        function("W_radial", "theta", Polar, &|i| unit_vector(layout.flank_form_index(height, i))),
        function("W_form", "theta", Polar, &|i| part_form_coefficients(layout, height, i)),
    ]
}

/// Error motion at a grid angle: the displacement without the effect of the axis position.
pub fn error_motion_coefficients(
    layout: &UnknownsLayout,
    height: usize,
    angle_index: usize,
    along_y: bool,
) -> Vec<f64> {
    let (cx, cy) = axis_position_coefficients(layout, height);
    let (sin, cos) = layout.design.grid_angle_rad(angle_index).sin_cos();
    let own = if along_y { layout.ey_index(height, angle_index) } else { layout.ex_index(height, angle_index) };
    let (near, far, turn) = if along_y { (&cy, &cx, -sin) } else { (&cx, &cy, sin) };
    let mut coefficients = slope_of_unknown(own, layout.unknown_count());
    for (k, c) in coefficients.iter_mut().enumerate() {
        *c += turn * far[k] - (1.0 - cos) * near[k];
    }
    coefficients
}

fn rad_to_rounded_deg(angle: f64) -> f64 {
    (angle.to_degrees() * 1e9).round() / 1e9
}

/// Mean of E_total over a turn: the axis position, unbiased for zero-mean error motion (METHODS
/// section 1). Coefficients for x and y.
pub fn axis_position_coefficients(layout: &UnknownsLayout, height: usize) -> (Vec<f64>, Vec<f64>) {
    let mut x = vec![0.0; layout.unknown_count()];
    let mut y = vec![0.0; layout.unknown_count()];
    for i in 0..layout.design.angle_count {
        x[layout.ex_index(height, i)] = 1.0 / layout.design.angle_count as f64;
        y[layout.ey_index(height, i)] = 1.0 / layout.design.angle_count as f64;
    }
    (x, y)
}

/// W without its mean and first harmonic: the form of the part without its set-up error.
fn part_form_coefficients(layout: &UnknownsLayout, height: usize, i: usize) -> Vec<f64> {
    let n = layout.design.angle_count;
    let mut coefficients = vec![0.0; layout.unknown_count()];
    for j in 0..n {
        let angle = layout.design.grid_angle_rad(i) - layout.design.grid_angle_rad(j);
        coefficients[layout.flank_form_index(height, j)] -= (1.0 + 2.0 * angle.cos()) / n as f64;
    }
    coefficients[layout.flank_form_index(height, i)] += 1.0;
    coefficients
}

/// Coefficients over the unknowns of E_YY1 − E_XX1 and of E_C0Y, from the second harmonic of E_r:
/// with E_lin = (−E_C0Y·y, (E_YY1 − E_XX1)·y), E_r = L(d·sin²φ − E_C0Y·sinφ·cosφ).
pub fn scale_and_squareness_coefficients(layout: &UnknownsLayout, height: usize, radius: f64) -> (Vec<f64>, Vec<f64>) {
    let n = layout.design.angle_count;
    let mut scale = vec![0.0; layout.unknown_count()];
    let mut square = vec![0.0; layout.unknown_count()];
    for i in 0..n {
        let (sin, cos) = (2.0 * layout.design.grid_angle_rad(i)).sin_cos();
        let weight = -4.0 / (n as f64 * radius);
        scale[layout.linear_axes_radial_error_index(height, i)] = weight * cos;
        square[layout.linear_axes_radial_error_index(height, i)] = weight * sin;
    }
    (scale, square)
}
