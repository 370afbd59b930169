//! Points in a plane, the circle fitted to them, and its centre with the expanded uncertainty.

use std::f64::consts::TAU;

use plotters::prelude::*;

use super::ticked_axis::{TickedAxis, value_bounds};
use super::{BAND_OPACITY, FIT_COLOUR, LINE_COLOUR, PICTURE_MARGIN, X_LABEL_HEIGHT};
use super::{draw_axes, draw_picture, finite_or_zero};
use machine::record::estimate::CircleFigure;

/// Side of the plot, which is square so that circles are not distorted.
const PLOT_SIDE: u32 = 744;

/// A path is closed if the ratio of its closing distance to the longest distance between neighbours is at most this.
const MAX_CLOSING_TO_LONGEST_SEGMENT_RATIO: f64 = 1.5;

/// Draws the figure; `None` if the circle is not finite.
pub(in crate::report) fn draw_circle(figure: &CircleFigure) -> Option<String> {
    let [x, y] = figure.centre;
    let [ux, uy] = figure.centre_expanded.map(finite_or_zero);
    let points = figure.x.iter().copied().zip(figure.y.iter().copied());
    let points: Vec<_> = points.filter(|(x, y)| x.is_finite() && y.is_finite()).collect();
    let path = close_path(&points);
    let half = plot_half_width(figure, &points)?;
    let ellipse = |rx: f64, ry: f64| -> Vec<_> {
        let angles = (0..=120).map(|n| f64::from(n) * TAU / 120.0);
        angles.map(|angle| (x + rx * angle.cos(), y + ry * angle.sin())).collect()
    };
    let unit = figure.unit.symbol();
    let (x_name, y_name) = (format!("x / {unit}"), format!("y / {unit}"));
    let axis = |middle: f64| TickedAxis::with_round_ticks(middle - half..middle + half);
    let (x_axis, y_axis) = (axis(x).titled(&x_name), axis(y).titled(&y_name));
    let width = y_axis.label_width() + PLOT_SIDE + 3 * PICTURE_MARGIN;
    draw_picture((width, X_LABEL_HEIGHT + PLOT_SIDE + 2 * PICTURE_MARGIN), |area| {
        let mut chart = draw_axes(area, x_axis, y_axis)?;
        chart.draw_series([Polygon::new(ellipse(ux, uy), FIT_COLOUR.mix(BAND_OPACITY))])?;
        chart.draw_series([PathElement::new(path, LINE_COLOUR.mix(0.5).stroke_width(2))])?;
        let fitted = ellipse(figure.radius, figure.radius);
        chart.draw_series([PathElement::new(fitted, FIT_COLOUR.stroke_width(3))])?;
        let cross = [vec![(x - ux, y), (x + ux, y)], vec![(x, y - uy), (x, y + uy)]];
        chart.draw_series(cross.map(|line| PathElement::new(line, FIT_COLOUR.stroke_width(3))))?;
        chart.draw_series(points.iter().map(|point| Circle::new(*point, 8, LINE_COLOUR.filled())))?;
        Ok(())
    })
}

/// The points in their order. The first point is repeated at the end if the path is closed.
fn close_path(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let length = |from: &(f64, f64), to: &(f64, f64)| (to.0 - from.0).hypot(to.1 - from.1);
    let longest = points.windows(2).map(|pair| length(&pair[0], &pair[1])).fold(0.0, f64::max);
    let ends = points.last().zip(points.first());
    let first_again =
        ends.filter(|(last, first)| length(last, first) <= MAX_CLOSING_TO_LONGEST_SEGMENT_RATIO * longest);
    points.iter().chain(first_again.map(|(_, first)| first)).copied().collect()
}

/// Half the side of the smallest square about the centre that contains everything, with a margin.
fn plot_half_width(figure: &CircleFigure, points: &[(f64, f64)]) -> Option<f64> {
    let [x, y] = figure.centre;
    if !(x.is_finite() && y.is_finite() && figure.radius.is_finite()) {
        return None;
    }
    let [ux, uy] = figure.centre_expanded.map(finite_or_zero);
    let away = points.iter().flat_map(|(px, py)| [px - x, py - y]);
    let (_, reach) = value_bounds(away.chain([figure.radius, ux, uy]).map(f64::abs))?;
    Some(if reach > 0.0 { 1.15 * reach } else { 1.0 })
}
