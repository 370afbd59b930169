//! Single values over a numeric argument, each with its uncertainty, without a line between them.

use plotters::prelude::*;

use super::ticked_axis::{TickedAxis, add_margin, value_bounds};
use super::{FIT_COLOUR, INK_COLOUR, LINE_COLOUR, PICTURE_SIZE, PlotPoint, curve, draw_picture};
use machine::record::estimate::EstimatedFunction;

/// Draws the function without uncertainties, and a circle about the mark of each of `circled_points` (x, y). `None`
/// without a finite value.
pub(in crate::report) fn draw_points_with_circles(
    function: &EstimatedFunction,
    circled_points: &[[f64; 2]],
) -> Option<String> {
    draw_points(function, &super::finite_plot_points(function, 0.0), circled_points)
}

pub(super) fn draw_points(
    function: &EstimatedFunction,
    samples: &[PlotPoint],
    circled_points: &[[f64; 2]],
) -> Option<String> {
    let ends = samples.iter().flat_map(PlotPoint::uncertainty_ends);
    let (low, high) = add_margin(value_bounds(ends.chain([0.0]))?);
    let (first, last) = add_margin(value_bounds(samples.iter().map(|sample| sample.x))?);
    let (x_name, y_name) = curve::axis_names_with_units(function);
    let [x_axis, y_axis] = [first..last, low..high].map(TickedAxis::with_round_ticks);
    draw_picture(PICTURE_SIZE, |area| {
        let mut chart = super::draw_axes(area, x_axis.titled(&x_name), y_axis.titled(&y_name))?;
        let zero = vec![(first, 0.0), (last, 0.0)];
        chart.draw_series([PathElement::new(zero, INK_COLOUR.stroke_width(2))])?;
        let bars = samples.iter().filter(|sample| sample.uncertainty_half_width > 0.0).map(|sample| {
            let ends = sample.uncertainty_ends().map(|y| (sample.x, y));
            PathElement::new(ends, LINE_COLOUR.mix(0.5).stroke_width(4))
        });
        chart.draw_series(bars)?;
        let marks = samples.iter().map(PlotPoint::coordinates);
        chart.draw_series(marks.map(|point| Circle::new(point, 7, LINE_COLOUR.filled())))?;
        let circled = circled_points.iter().map(|[x, y]| (*x, *y));
        chart.draw_series(circled.map(|point| Circle::new(point, 14, FIT_COLOUR.stroke_width(4))))?;
        Ok(())
    })
}
