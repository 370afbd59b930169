//! A function over a straight axis, with its uncertainty band: one curve, or several over the same range.

use plotters::prelude::*;

use super::ticked_axis::{TickedAxis, add_margin, value_bounds};
use super::{BAND_OPACITY, LINE_COLOUR, MAX_POINTS_WITH_MARKS, PICTURE_SIZE, PlotPoint, draw_picture, full_turn};
use crate::report::number;
use machine::record::estimate::EstimatedFunction;

/// Maximum number of columns into which a curve of more than twice as many points is divided: only the lowest and
/// highest point of each column are drawn, because the others are not visible.
const COLUMN_COUNT: usize = 400;

pub(super) fn draw_curve(function: &EstimatedFunction, samples: &[PlotPoint]) -> Option<String> {
    let (low, high) = add_margin(value_bounds(samples.iter().flat_map(PlotPoint::uncertainty_ends))?);
    let curves = separate_curves(function, samples);
    let (x_name, y_name) = axis_names_with_units(function);
    let x_axis = x_axis(function, curves.iter().flatten())?.titled(&x_name);
    let y_axis = TickedAxis::with_round_ticks(low..high).titled(&y_name);
    draw_picture(PICTURE_SIZE, |area| {
        let mut chart = super::draw_axes(area, x_axis, y_axis)?;
        for curve in &curves {
            if curve.iter().any(|sample| sample.uncertainty_half_width > 0.0) {
                let upper = curve.iter().map(|sample| (sample.x, sample.y + sample.uncertainty_half_width));
                let lower = curve.iter().rev().map(|sample| (sample.x, sample.y - sample.uncertainty_half_width));
                let band: Vec<_> = upper.chain(lower).collect();
                chart.draw_series([Polygon::new(band, LINE_COLOUR.mix(BAND_OPACITY))])?;
            }
            let line: Vec<_> = curve.iter().map(PlotPoint::coordinates).collect();
            let width = if line.len() <= COLUMN_COUNT { 4 } else { 2 };
            chart.draw_series([PathElement::new(line.clone(), LINE_COLOUR.stroke_width(width))])?;
            if line.len() <= MAX_POINTS_WITH_MARKS {
                chart.draw_series(line.iter().map(|point| Circle::new(*point, 7, LINE_COLOUR.filled())))?;
            }
        }
        Ok(())
    })
}

/// The curves of a function, each with as many points as are visible: a new curve begins where x decreases. A full
/// turn of an angle is closed.
fn separate_curves(function: &EstimatedFunction, samples: &[PlotPoint]) -> Vec<Vec<PlotPoint>> {
    let pieces = samples.chunk_by(|sample, next| sample.x <= next.x);
    let closed = pieces.map(|piece| match function.argument_unit.as_str() {
        "deg" => full_turn::close_full_turn(piece),
        _ => piece.to_vec(),
    });
    closed.map(|curve| extremes_of_columns(&curve)).collect()
}

/// The lowest and the highest point of each column, and both ends of the curve; all points of a short curve.
fn extremes_of_columns(curve: &[PlotPoint]) -> Vec<PlotPoint> {
    if curve.len() <= 2 * COLUMN_COUNT {
        return curve.to_vec();
    }
    let lower = |a: &(usize, &PlotPoint), b: &(usize, &PlotPoint)| a.1.y.total_cmp(&b.1.y);
    let columns = curve.chunks(curve.len().div_ceil(COLUMN_COUNT));
    let (first, last) = (curve.first().copied(), curve.last().copied());
    let extremes = columns.flat_map(|column| {
        let lowest = column.iter().enumerate().min_by(lower);
        let highest = column.iter().enumerate().max_by(lower);
        let mut both: Vec<_> = lowest.into_iter().chain(highest).collect();
        both.sort_by_key(|(index, _)| *index);
        both.into_iter().map(|(_, sample)| *sample)
    });
    // The ends stay, so that the curve covers its whole range.
    let mut thinned: Vec<PlotPoint> = first.into_iter().chain(extremes).chain(last).collect();
    thinned.dedup_by(|one, other| one.x == other.x && one.y == other.y);
    thinned
}

/// Names of both axes with their units.
pub(super) fn axis_names_with_units(function: &EstimatedFunction) -> (String, String) {
    let argument = argument_name(&function.argument);
    let x_name = match function.argument_unit.as_str() {
        "" => argument.to_owned(),
        unit => format!("{argument} / {}", number::argument_unit_symbol(unit)),
    };
    let unit = function.unit.symbol();
    (x_name, format!("{} / {unit}", number::one_line_symbol(&function.symbol)))
}

/// Display of the name of an argument, as written in the estimate.
pub(in crate::report) fn argument_name(argument: &str) -> &str {
    match argument {
        "theta" => "θ",
        "phi" => "φ",
        other => other,
    }
}

/// The x axis: steps of 45° for angles over more than 180° and up to 360°, otherwise round steps over the data.
fn x_axis<'a>(function: &EstimatedFunction, samples: impl Iterator<Item = &'a PlotPoint>) -> Option<TickedAxis> {
    let (first, last) = value_bounds(samples.map(|sample| sample.x))?;
    let (low, high) = if last > first { (first, last) } else { add_margin((first, last)) };
    let is_turn = function.argument_unit == "deg" && last - first > 180.0 && last - first <= 360.0;
    Some(match is_turn {
        true if first >= 0.0 && last <= 360.0 => TickedAxis::with_tick_step(45.0, 0.0..360.0),
        true => TickedAxis::with_tick_step(45.0, low..high),
        false => TickedAxis::with_round_ticks(low..high),
    })
}
