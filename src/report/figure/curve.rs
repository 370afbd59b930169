//! A function over a straight axis, with its uncertainty band: one curve, or several over the same range.

use plotters::prelude::*;

use super::ticked_axis::{TickedAxis, add_margin, value_bounds};
use super::{BAND_OPACITY, LINE_COLOUR, MAX_POINTS_WITH_MARKS, PlotPoint, draw_picture};
use crate::report::number;
use machine::record::estimate::EstimatedFunction;

const PICTURE_SIZE: (u32, u32) = (1400, 640);

pub(super) fn draw_curve(function: &EstimatedFunction, samples: &[PlotPoint]) -> Option<String> {
    let (low, high) = value_bounds(
        samples
            .iter()
            .flat_map(|sample| [sample.y - sample.uncertainty_half_width, sample.y + sample.uncertainty_half_width]),
    )?;
    let (low, high) = add_margin((low, high));
    let x_axis = x_axis(function, samples)?;
    let (x_name, y_name) = axis_names_with_units(function);
    draw_picture(PICTURE_SIZE, |area| {
        let mut chart =
            super::draw_axes(area, x_axis.titled(&x_name), TickedAxis::with_round_ticks(low..high).titled(&y_name))?;
        for samples in samples.chunk_by(|sample, next| sample.x <= next.x) {
            let upper = samples.iter().map(|sample| (sample.x, sample.y + sample.uncertainty_half_width));
            let lower = samples.iter().rev().map(|sample| (sample.x, sample.y - sample.uncertainty_half_width));
            let band: Vec<_> = upper.chain(lower).collect();
            chart.draw_series([Polygon::new(band, LINE_COLOUR.mix(BAND_OPACITY))])?;
            let line: Vec<_> = samples.iter().map(|sample| (sample.x, sample.y)).collect();
            chart.draw_series([PathElement::new(line.clone(), LINE_COLOUR.stroke_width(4))])?;
            if line.len() <= MAX_POINTS_WITH_MARKS {
                chart.draw_series(line.iter().map(|point| Circle::new(*point, 7, LINE_COLOUR.filled())))?;
            }
        }
        Ok(())
    })
}

/// Names of both axes with their units.
pub(super) fn axis_names_with_units(function: &EstimatedFunction) -> (String, String) {
    let x_name = match function.argument_unit.as_str() {
        "" => function.argument.clone(),
        unit => format!("{} / {}", function.argument, number::argument_unit_symbol(unit)),
    };
    let unit = number::unit_symbol(function.unit);
    (x_name, format!("{} / {unit}", number::one_line_symbol(&function.symbol)))
}

/// The x axis: a full turn in steps of 45° for angles, otherwise round steps over the data.
fn x_axis(function: &EstimatedFunction, samples: &[PlotPoint]) -> Option<TickedAxis> {
    let (first, last) = value_bounds(samples.iter().map(|sample| sample.x))?;
    let (low, high) = if last > first { (first, last) } else { add_margin((first, last)) };
    let turn = function.argument_unit == "deg" && first >= 0.0 && last <= 360.0;
    Some(if turn { TickedAxis::with_tick_step(45.0, 0.0..360.0) } else { TickedAxis::with_round_ticks(low..high) })
}
