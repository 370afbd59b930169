//! Outputs: the map, the stylus offset, the effective radius, the effects of the feed.

use machine::record::estimate::{FunctionFigureKind, Unit};
use nalgebra::Vector3;

use super::setup::QualificationSetup;
use super::unknowns_layout::{UnknownsLayout, harmonic_factors};
use crate::identification::probe_map::probe_map_symbols;
use crate::identification::{IdentificationOutputs, OutputCurve, OutputParameter, slope_of_unknown};

/// Step of the curves, degrees.
const CURVE_STEP_DEG: usize = 5;

pub fn build_outputs(setup: &QualificationSetup<'_>, layout: &UnknownsLayout, x: &[f64]) -> IdentificationOutputs {
    let mut parameters = Vec::new();
    if let Some(first) = layout.map_orders.iter().position(|order| *order == 1) {
        // A stylus that is offset towards the surface contacts it earlier.
        for (symbol, at) in
            [("x_stylus", layout.map_cosine_index(first)), ("y_stylus", layout.map_cosine_index(first) + 1)]
        {
            let slope = slope_of_unknown(at, x.len()).into_iter().map(|slope| -slope).collect();
            parameters.push(OutputParameter::from_coefficients(symbol, Unit::Um, slope, x));
        }
    }
    for (index, order) in layout.map_orders.iter().enumerate() {
        // Without a certificate the form of the ball has no bound.
        if *order > 1 && !layout.is_order_separable(*order) && setup.settings.certified_roundness_um.is_none() {
            continue;
        }
        let unknowns = [layout.map_cosine_index(index), layout.map_cosine_index(index) + 1];
        let parts = probe_map_symbols(*order).into_iter().zip(unknowns);
        parameters.extend(parts.map(|(symbol, at)| OutputParameter::from_unknown(&symbol, Unit::Um, at, x)));
    }
    parameters.push(OutputParameter::from_unknown("r_stylus", Unit::Um, layout.radius_index(), x));
    let mut curves = vec![azimuth_curve("E_probe", layout, x, layout.map_cosine_index(0), &layout.map_orders)];
    if !layout.fast_difference_orders.is_empty() {
        parameters.push(OutputParameter::from_unknown("t_latch", Unit::Ms, layout.latch_delay_index(), x));
        curves.push(azimuth_curve(
            "E_probe_fast",
            layout,
            x,
            layout.fast_difference_cosine_index(0),
            &layout.fast_difference_orders,
        ));
    }
    IdentificationOutputs { linear_parameters: parameters, curves, nonlinear: None }
}

/// Sum of the `orders` over the azimuth in the spindle frame, for contacts perpendicular to the spindle.
/// `first_unknown`: index of the first unknown of the `orders`.
fn azimuth_curve(
    symbol: &str,
    layout: &UnknownsLayout,
    x: &[f64],
    first_unknown: usize,
    orders: &[u32],
) -> OutputCurve {
    let degrees: Vec<f64> = (0..360).step_by(CURVE_STEP_DEG).map(f64::from).collect();
    let slope = |degrees: &f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let mut slope = vec![0.0; layout.unknown_count()];
        for (index, order) in orders.iter().enumerate() {
            let at = first_unknown + 2 * index;
            slope[at..at + 2].copy_from_slice(&harmonic_factors(*order, &Vector3::new(cos, sin, 0.0)));
        }
        slope
    };
    let slopes: Vec<Vec<f64>> = degrees.iter().map(slope).collect();
    let value = |slope: &Vec<f64>| slope.iter().zip(x).map(|(slope, x)| slope * x).sum();
    OutputCurve {
        symbol: symbol.to_owned(),
        argument: "azimuth",
        argument_unit: "deg",
        x: degrees,
        y: slopes.iter().map(value).collect(),
        unit: Unit::Um,
        figure: FunctionFigureKind::Polar,
        slopes,
    }
}
