//! Figures of an estimate with their captions.

use minijinja::{Value, context};

use super::figure::MotionCentre;
use super::{figure, number};
use machine::record::estimate::{CircleFigure, Estimate, EstimatedFunction, FunctionFigureKind};

/// Template values of all figures of an estimate: functions first, then circles.
pub fn figure_values(estimate: &Estimate) -> Vec<Value> {
    // Functions state u alone; the largest k of the table belongs to the fewest degrees of freedom.
    let identified = estimate.parameters.iter().filter(|parameter| parameter.identifiable);
    let k = identified.map(|parameter| parameter.k).reduce(f64::max).unwrap_or(2.0);
    let k = if k.is_finite() { k } else { 2.0 };
    let functions = estimate.functions.iter().map(|function| function_figure_values(function, k));
    functions.chain(estimate.circles.iter().map(circle_figure_values)).collect()
}

fn function_figure_values(function: &EstimatedFunction, k: f64) -> Value {
    context! {
        symbol => symbol_value(&function.symbol),
        caption => function_caption(function, k),
        square => function.figure == FunctionFigureKind::Polar,
        svg => svg_value(figure::draw_function(function, k)),
    }
}

fn function_caption(function: &EstimatedFunction, k: f64) -> String {
    let stated = function.u.iter().any(|u| *u > 0.0);
    match function.figure {
        FunctionFigureKind::Histogram => {
            let count = function.y.len();
            match function.y.iter().all(|value| *value >= 0.0) {
                true => format!("{count} values"),
                false => {
                    format!(
                        "{count} values, and the normal distribution with the same mean and standard \
                        deviation"
                    )
                }
            }
        }
        FunctionFigureKind::Points | FunctionFigureKind::Curve if !stated => format!("over {}", function.argument),
        FunctionFigureKind::Spectrum if !stated => "over harmonic order".to_owned(),
        FunctionFigureKind::Spectrum => format!("amplitude over harmonic order, {}", uncertainty_band_caption(k)),
        _ => {
            let value = error_motion_caption(function).unwrap_or_default();
            let height = function.at_mm.map(|[_, _, z]| format!(", at Z = {z:.1} mm"));
            let height = height.unwrap_or_default();
            format!("over {}{height}, {}{value}", function.argument, uncertainty_band_caption(k))
        }
    }
}

fn uncertainty_band_caption(k: f64) -> String {
    format!("with ±U (k = {})", number::format_fixed(k, 2))
}

/// Sentence about the circles of an error motion figure.
fn error_motion_caption(function: &EstimatedFunction) -> Option<String> {
    let (centre, circles) = figure::motion_circles_of_polar_figure(function)?;
    let u = function.u.iter().copied().filter(|u| *u > 0.0).reduce(f64::max).unwrap_or(0.0);
    let value = number::format_fixed(circles.value(), number::decimals_for_uncertainty(u));
    let centre = match centre {
        MotionCentre::LeastSquares => "the least-squares circle centre",
        MotionCentre::Chart => "the polar chart centre",
    };
    let unit = number::unit_symbol(function.unit);
    Some(format!("; error motion value {value} {unit}: distance of the circles about {centre} (cross)"))
}

fn circle_figure_values(circle: &CircleFigure) -> Value {
    let [ux, uy] = circle.centre_expanded;
    let decimals = number::decimals_for_uncertainty(ux.min(uy));
    let [x, y] = circle.centre.map(|value| number::format_fixed(value, decimals));
    let [ux, uy] = [ux, uy].map(|value| number::format_fixed(value, decimals));
    let radius = number::format_fixed(circle.radius, decimals);
    let unit = number::unit_symbol(circle.unit);
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

pub(super) fn symbol_value(symbol: &str) -> Value {
    let (base, index) = number::split_into_base_and_index(symbol);
    context! { plain => symbol, base, index }
}

pub(super) fn svg_value(svg: Option<String>) -> Value {
    svg.map_or(Value::from(()), Value::from_safe_string)
}
