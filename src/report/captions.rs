//! Figures of an estimate with their captions.

use minijinja::{Value, context};

use super::figure::{self, AxisSketch, FunctionFigure, MotionCentre, RemovedCircle};
use super::number;
use machine::geometric_error_name;
use machine::record::estimate::{CircleFigure, Estimate, EstimatedFunction, FunctionFigureKind};

/// Template values of all figures of an estimate: functions first, then circles.
pub fn figure_values(estimate: &Estimate) -> Vec<Value> {
    // A function has u, but no k of its own. It is drawn with the largest k of the parameters.
    let identified = estimate.parameters.iter().filter(|parameter| parameter.identifiable);
    let k = identified.map(|parameter| parameter.k).reduce(f64::max).unwrap_or(2.0);
    let k = if k.is_finite() { k } else { 2.0 };
    let functions = estimate.functions.iter().map(|function| function_figure_values(function, k));
    functions.chain(estimate.circles.iter().map(circle_figure_values)).collect()
}

fn function_figure_values(function: &EstimatedFunction, k: f64) -> Value {
    let figure = FunctionFigure::new(function, k);
    context! {
        symbol => symbol_value(&function.symbol),
        caption => function_caption(function, &figure, k),
        square => figure.kind == FunctionFigureKind::Polar,
        svg => svg_value(figure.draw()),
    }
}

fn function_caption(function: &EstimatedFunction, figure: &FunctionFigure<'_>, k: f64) -> String {
    let is_u_stated = function.u.iter().any(|u| *u > 0.0);
    let band = if is_u_stated { format!(", {}", uncertainty_band_caption(k)) } else { String::new() };
    let argument = figure::argument_name(&function.argument);
    match figure.kind {
        FunctionFigureKind::Histogram => histogram_caption(function),
        FunctionFigureKind::Points | FunctionFigureKind::Curve => {
            format!("over {argument}{}{band}", z_position_caption(function))
        }
        FunctionFigureKind::Spectrum => format!("amplitude over harmonic order{band}"),
        FunctionFigureKind::Polar => {
            let division = division_caption(function, figure);
            let (removed, motion) =
                (removed_eccentricity_caption(function, figure, k), error_motion_caption(function, figure, k));
            let details: String = [division, removed, motion].into_iter().flatten().collect();
            format!("over {argument}{}{band}{details}", z_position_caption(function))
        }
    }
}

fn histogram_caption(function: &EstimatedFunction) -> String {
    let count = function.y.len();
    match function.y.iter().all(|value| *value >= 0.0) {
        true => format!("{count} values"),
        false => format!("{count} values, and the normal distribution with the same mean and standard deviation"),
    }
}

/// Z position for which a displacement is valid.
fn z_position_caption(function: &EstimatedFunction) -> String {
    function.at_mm.map(|[_, _, z]| format!(", at Z = {} mm", number::format_fixed(z, 1))).unwrap_or_default()
}

/// Magnification of a polar figure.
fn division_caption(function: &EstimatedFunction, figure: &FunctionFigure<'_>) -> Option<String> {
    let division = figure.polar_division()?;
    Some(format!("; 1 division = {division}\u{a0}{}", function.unit.symbol()))
}

/// Mean and eccentricity that are removed from a polar figure before drawing.
fn removed_eccentricity_caption(function: &EstimatedFunction, figure: &FunctionFigure<'_>, k: f64) -> Option<String> {
    let RemovedCircle { mean, eccentricity, direction_deg } = figure.removed_circle?;
    let decimals = number::decimals_for_uncertainty(k * largest_u(function));
    let [mean, eccentricity, zero] = [mean, eccentricity, 0.0].map(|value| number::format_fixed(value, decimals));
    let (unit, direction) = (function.unit.symbol(), number::format_fixed(direction_deg, 1));
    let mean = if mean == zero { String::new() } else { format!(" and mean {mean}\u{a0}{unit}") };
    Some(format!("; removed before drawing: eccentricity {eccentricity}\u{a0}{unit} towards {direction}°{mean}"))
}

fn uncertainty_band_caption(k: f64) -> String {
    format!("with ±U (k = {})", number::format_fixed(k, 2))
}

/// Value of an error motion and the centre of its circles.
fn error_motion_caption(function: &EstimatedFunction, figure: &FunctionFigure<'_>, k: f64) -> Option<String> {
    let (centre, circles) = figure.error_motion_circles?;
    let value = number::format_fixed(circles.value(), number::decimals_for_uncertainty(k * largest_u(function)));
    let centre = match centre {
        MotionCentre::LeastSquares => "the least-squares circle centre",
        MotionCentre::Chart => "the polar chart centre",
    };
    let unit = function.unit.symbol();
    Some(format!("; error motion value {value}\u{a0}{unit} about {centre}"))
}

/// Largest standard uncertainty of the function; 0 if none is stated.
fn largest_u(function: &EstimatedFunction) -> f64 {
    function.u.iter().copied().filter(|u| *u > 0.0).fold(0.0, f64::max)
}

fn circle_figure_values(circle: &CircleFigure) -> Value {
    let [ux, uy] = circle.centre_expanded;
    let pair = |value: f64, expanded: f64| {
        let decimals = number::decimals_for_uncertainty(expanded);
        [value, expanded].map(|value| number::format_fixed(value, decimals))
    };
    let [[x, ux], [y, uy]] = [pair(circle.centre[0], ux), pair(circle.centre[1], uy)];
    let [radius, _] = pair(circle.radius, circle.centre_expanded[0].max(circle.centre_expanded[1]));
    let unit = circle.unit.symbol();
    context! {
        symbol => symbol_value(&circle.symbol),
        caption => format!(
            "points in their order and fitted circle, radius {radius} {unit}; centre with ±U: \
             x = ({x} ± {ux}) {unit}, y = ({y} ± {uy}) {unit}"
        ),
        square => true,
        svg => svg_value(figure::draw_circle(circle)),
    }
}

/// Whether the estimate has location errors, which are drawn in a sketch.
pub fn has_location_errors(estimate: &Estimate) -> bool {
    let symbols: Vec<&str> = estimate.parameters.iter().map(|parameter| parameter.symbol.as_str()).collect();
    !figure::axes_with_location_errors(&symbols).is_empty()
}

/// Template values of the sketch of each axis with location errors.
pub(super) fn sketch_values(estimate: &Estimate) -> Vec<Value> {
    let symbols: Vec<&str> = estimate.parameters.iter().map(|parameter| parameter.symbol.as_str()).collect();
    let sketches = figure::axes_with_location_errors(&symbols).into_iter();
    let sketches = sketches.filter_map(|axis| AxisSketch::new(axis, &symbols));
    sketches.map(|sketch| context! { caption => sketch_caption(&sketch), svg => svg_value(sketch.draw()) }).collect()
}

fn sketch_caption(sketch: &AxisSketch) -> String {
    let named = |symbol: &str| {
        let name = geometric_error_name(symbol).unwrap_or_default();
        format!("{}: {name}", number::one_line_symbol(symbol))
    };
    let texts: Vec<String> = sketch.symbols().into_iter().map(named).collect();
    format!("Location errors of {}, drawn positive and not to scale. {}", sketch.axis, texts.join("; "))
}

pub(super) fn symbol_value(symbol: &str) -> Value {
    let (base, index) = number::split_into_base_and_index(symbol);
    context! { plain => symbol, base, index }
}

/// A picture for the page, in as few bytes as possible.
pub(super) fn svg_value(svg: Option<String>) -> Value {
    svg.map_or(Value::from(()), |svg| Value::from_safe_string(figure::compact_svg(&svg)))
}
