//! A function of an angle in a polar chart: 0° is to the right, angles count counter-clockwise. Error motions have
//! the circles and centres of ISO 230-7.

use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::ticked_axis::{add_margin, round_up_to_1_2_or_5, tick_label, value_bounds};
use super::{
    Area, BAND_OPACITY, DrawResult, FIT_COLOUR, FONT_SIZE, FunctionFigure, GRID_COLOUR, INK_COLOUR, LINE_COLOUR,
    MAX_POINTS_WITH_MARKS, MotionCircles, PlotPoint,
};
use super::{curve, draw_picture, full_turn, text_style};
use crate::report::number;

const PICTURE_SIDE: u32 = 900;
const CENTRE_COORDINATE: i32 = 450;
const OUTER_RING_RADIUS: f64 = 360.0;
/// Radius of the ring of the smallest value. The chart magnifies the deviations, not the radius of the part.
const INNER_RING_RADIUS: f64 = 120.0;
/// Distance of the labels in the corners from the edges of the picture.
const CORNER_MARGIN: i32 = 12;
/// Maximum number of divisions within the range of the values; more ring labels would overlap.
const MAX_DIVISIONS: f64 = 5.0;
/// Maximum angle of a chord that approximates an arc, degrees.
const MAX_CHORD_DEG: f64 = 3.0;
/// Half the length of the mark of a centre.
const CENTRE_MARK_HALF_LENGTH: i32 = 18;
/// Lengths of a dash and of the gap after it in the mean circle.
const MEAN_CIRCLE_DASH_AND_GAP_LENGTH: (u32, u32) = (18, 12);

/// Scale from values to radii in the picture.
struct RadiusScale {
    lowest_ring_value: f64,
    highest_ring_value: f64,
    ring_step: f64,
}

impl RadiusScale {
    /// Scale of a figure; `None` without a sample.
    fn for_figure(figure: &FunctionFigure<'_>) -> Option<Self> {
        let ends = figure.samples.iter().flat_map(PlotPoint::uncertainty_ends);
        let of_circles = figure.error_motion_circles.into_iter().flat_map(|(_, circles)| {
            let [x, y] = circles.centre;
            [circles.inner - x.hypot(y), circles.outer + x.hypot(y)]
        });
        let (low, high) = value_bounds(ends.chain(of_circles)).filter(|_| !figure.samples.is_empty())?;
        Some(Self::with_rings_enclosing(low, high))
    }

    /// Scale rings at round values that enclose `low..high`.
    fn with_rings_enclosing(low: f64, high: f64) -> Self {
        let (low, high) = if high > low { (low, high) } else { add_margin((low, high)) };
        let step = round_up_to_1_2_or_5((high - low) / MAX_DIVISIONS);
        Self {
            lowest_ring_value: (low / step).floor() * step,
            highest_ring_value: (high / step).ceil() * step,
            ring_step: step,
        }
    }

    fn ring_values(&self) -> impl Iterator<Item = f64> + '_ {
        let count = ((self.highest_ring_value - self.lowest_ring_value) / self.ring_step).round() as i32;
        (0..=count).map(|n| self.lowest_ring_value + f64::from(n) * self.ring_step)
    }

    fn picture_radius(&self, value: f64) -> f64 {
        INNER_RING_RADIUS + self.picture_length(value - self.lowest_ring_value)
    }

    fn picture_length(&self, difference: f64) -> f64 {
        (OUTER_RING_RADIUS - INNER_RING_RADIUS) * difference / (self.highest_ring_value - self.lowest_ring_value)
    }

    fn picture_point(&self, degrees: f64, value: f64) -> (i32, i32) {
        polar_to_picture_point(degrees, self.picture_radius(value))
    }
}

fn polar_to_picture_point(degrees: f64, radius: f64) -> (i32, i32) {
    let (sin, cos) = degrees.to_radians().sin_cos();
    (CENTRE_COORDINATE + (radius * cos).round() as i32, CENTRE_COORDINATE - (radius * sin).round() as i32)
}

/// Difference in value between two neighbouring rings: the magnification of the chart.
pub(super) fn division_value(figure: &FunctionFigure<'_>) -> Option<f64> {
    Some(RadiusScale::for_figure(figure)?.ring_step)
}

pub(super) fn draw_polar(figure: &FunctionFigure<'_>) -> Option<String> {
    let scale = RadiusScale::for_figure(figure)?;
    let closed = full_turn::close_full_turn(&figure.samples);
    let outline = |offset: f64| {
        outline_along_arcs(&closed, |s| scale.picture_point(s.x, s.y + offset * s.uncertainty_half_width))
    };
    let circles = figure.error_motion_circles.map(|(_, circles)| circles);
    draw_picture((PICTURE_SIDE, PICTURE_SIDE), |area| {
        draw_rings(area, &scale)?;
        if closed.iter().any(|sample| sample.uncertainty_half_width > 0.0) {
            // One ring-shaped area: along the upper bound, and back along the lower.
            let band: Vec<_> = outline(1.0).into_iter().chain(outline(-1.0).into_iter().rev()).collect();
            area.draw(&Polygon::new(band, LINE_COLOUR.mix(BAND_OPACITY)))?;
        }
        circles.map_or(Ok(()), |circles| draw_motion_circles(area, &scale, &circles))?;
        area.draw(&PathElement::new(outline(0.0), LINE_COLOUR.stroke_width(4)))?;
        if figure.samples.len() <= MAX_POINTS_WITH_MARKS && circles.is_none() {
            for sample in &figure.samples {
                area.draw(&Circle::new(scale.picture_point(sample.x, sample.y), 7, LINE_COLOUR.filled()))?;
            }
        }
        draw_ring_labels(area, &scale)?;
        draw_corner_labels(area, figure, &scale)
    })
}

/// Draws the circles just inside and just outside the curve, the mean circle dashed, and both centres: an upright cross
/// at the centre of the chart, a diagonal one at the centre of the circles.
fn draw_motion_circles(area: &Area<'_>, scale: &RadiusScale, circles: &MotionCircles) -> DrawResult {
    let circle = |value: f64| -> Vec<_> {
        let degrees = (0..=120).map(|n| f64::from(n) * MAX_CHORD_DEG);
        degrees.map(|at| scale.picture_point(at, value + circles.centre_offset_at_angle(at))).collect()
    };
    for value in [circles.inner, circles.outer] {
        area.draw(&PathElement::new(circle(value), FIT_COLOUR.stroke_width(2)))?;
    }
    let (dash, gap) = MEAN_CIRCLE_DASH_AND_GAP_LENGTH;
    area.draw(&DashedPathElement::new(circle(circles.mean), dash, gap, FIT_COLOUR.stroke_width(3)))?;
    let half = CENTRE_MARK_HALF_LENGTH;
    let at = |x: i32, y: i32| (CENTRE_COORDINATE + x, CENTRE_COORDINATE - y);
    for line in [[at(-half, 0), at(half, 0)], [at(0, -half), at(0, half)]] {
        area.draw(&PathElement::new(line, INK_COLOUR.stroke_width(2)))?;
    }
    let [x, y] = circles.centre.map(|value| scale.picture_length(value).round() as i32);
    for line in [[at(x - half, y - half), at(x + half, y + half)], [at(x - half, y + half), at(x + half, y - half)]] {
        area.draw(&PathElement::new(line, FIT_COLOUR.stroke_width(4)))?;
    }
    Ok(())
}

/// Draws the scale rings, and a radial line with its angle every 45°.
fn draw_rings(area: &Area<'_>, scale: &RadiusScale) -> DrawResult {
    let centred = text_style(FONT_SIZE).pos(Pos::new(HPos::Center, VPos::Center));
    let all_degrees = || (0..360).step_by(45).map(f64::from);
    for degrees in all_degrees() {
        let spoke = [INNER_RING_RADIUS, OUTER_RING_RADIUS].map(|radius| polar_to_picture_point(degrees, radius));
        area.draw(&PathElement::new(spoke, GRID_COLOUR.stroke_width(2)))?;
    }
    for value in scale.ring_values() {
        let is_zero = value.abs() < scale.ring_step / 2.0;
        let style = if is_zero { INK_COLOUR.stroke_width(2) } else { GRID_COLOUR.stroke_width(2) };
        let radius = scale.picture_radius(value).round() as i32;
        area.draw(&Circle::new((CENTRE_COORDINATE, CENTRE_COORDINATE), radius, style))?;
    }
    for degrees in all_degrees() {
        let place = polar_to_picture_point(degrees, OUTER_RING_RADIUS + 44.0);
        area.draw(&Text::new(format!("{degrees}°"), place, centred.clone()))?;
    }
    Ok(())
}

/// Draws the labels of the scale rings, above all curves.
fn draw_ring_labels(area: &Area<'_>, scale: &RadiusScale) -> DrawResult {
    let style = text_style(0.9 * FONT_SIZE).pos(Pos::new(HPos::Center, VPos::Center));
    for value in scale.ring_values() {
        let text = tick_label(value, scale.ring_step);
        area.draw(&Text::new(text, polar_to_picture_point(67.5, scale.picture_radius(value)), style.clone()))?;
    }
    Ok(())
}

/// Draws quantity, angle and magnification in the corners.
fn draw_corner_labels(area: &Area<'_>, figure: &FunctionFigure<'_>, scale: &RadiusScale) -> DrawResult {
    let function = figure.function;
    let unit = function.unit.symbol();
    let far = PICTURE_SIDE as i32 - CORNER_MARGIN;
    let style = |h, v| text_style(FONT_SIZE).pos(Pos::new(h, v));
    let quantity = format!("{} / {unit}", number::one_line_symbol(&function.symbol));
    let division = format!("1 div = {} {unit}", tick_label(scale.ring_step, scale.ring_step));
    let angle = format!("{} / °", curve::argument_name(&function.argument));
    area.draw(&Text::new(quantity, (CORNER_MARGIN, CORNER_MARGIN), style(HPos::Left, VPos::Top)))?;
    area.draw(&Text::new(division, (CORNER_MARGIN, far), style(HPos::Left, VPos::Bottom)))?;
    area.draw(&Text::new(angle, (far, far), style(HPos::Right, VPos::Bottom)))?;
    Ok(())
}

/// The outline through `samples`, along arcs instead of chords.
fn outline_along_arcs(samples: &[PlotPoint], point: impl Fn(PlotPoint) -> (i32, i32)) -> Vec<(i32, i32)> {
    let mut outline: Vec<_> = samples.first().map(|first| point(*first)).into_iter().collect();
    for pair in samples.windows(2) {
        let (from, to) = (pair[0], pair[1]);
        let chords = ((to.x - from.x).abs() / MAX_CHORD_DEG).ceil().clamp(1.0, 360.0);
        let between = |a: f64, b: f64, n: i32| a + (b - a) * f64::from(n) / chords;
        outline.extend((1..=chords as i32).map(|n| {
            point(PlotPoint {
                x: between(from.x, to.x, n),
                y: between(from.y, to.y, n),
                uncertainty_half_width: between(from.uncertainty_half_width, to.uncertainty_half_width, n),
            })
        }));
    }
    outline
}
