//! A function of an angle in a polar chart: 0° is to the right, angles count counter-clockwise.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::ticked_axis::{add_margin, round_up_to_1_2_or_5, tick_label, value_bounds};
use super::{
    Area, BAND_OPACITY, DrawResult, FIT_COLOUR, FONT_SIZE, GRID_COLOUR, INK_COLOUR, LINE_COLOUR, MAX_POINTS_WITH_MARKS,
    MotionCircles, PlotPoint,
};
use super::{draw_picture, text_style};
use crate::report::number;
use machine::record::estimate::EstimatedFunction;

const PICTURE_SIDE: u32 = 900;
const CENTRE_COORDINATE: i32 = 450;
const OUTER_RING_RADIUS: f64 = 360.0;
/// Radius of the smallest value: the chart magnifies the deviations, not the part.
const INNER_RING_RADIUS: f64 = 120.0;
/// Maximum angle of a chord that approximates an arc, degrees.
const MAX_CHORD_DEG: f64 = 2.0;
/// Half the length of the mark of a centre.
const CENTRE_CROSS_HALF_LENGTH: i32 = 18;

/// Scale from values to radii in the picture.
struct RadiusScale {
    lowest_ring_value: f64,
    highest_ring_value: f64,
    ring_step: f64,
}

impl RadiusScale {
    /// Scale rings at round values that enclose `low..high`.
    fn with_rings_enclosing(low: f64, high: f64) -> Self {
        let (low, high) = if high > low { (low, high) } else { add_margin((low, high)) };
        let step = round_up_to_1_2_or_5((high - low) / 4.0);
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

pub(super) fn draw_polar(
    function: &EstimatedFunction,
    samples: &[PlotPoint],
    circles: Option<MotionCircles>,
) -> Option<String> {
    let ends = samples
        .iter()
        .flat_map(|sample| [sample.y - sample.uncertainty_half_width, sample.y + sample.uncertainty_half_width]);
    let of_circles = circles.into_iter().flat_map(|circles| {
        let [x, y] = circles.centre;
        [circles.inner - x.hypot(y), circles.outer + x.hypot(y)]
    });
    let (low, high) = value_bounds(ends.chain(of_circles)).filter(|_| !samples.is_empty())?;
    let scale = RadiusScale::with_rings_enclosing(low, high);
    let outline =
        |offset: f64| closed_outline(samples, |s| scale.picture_point(s.x, s.y + offset * s.uncertainty_half_width));
    draw_picture((PICTURE_SIDE, PICTURE_SIDE), |area| {
        draw_rings(area, &scale)?;
        // One ring-shaped area: along the upper bound, and back along the lower.
        let band: Vec<_> = outline(1.0).into_iter().chain(outline(-1.0).into_iter().rev()).collect();
        area.draw(&Polygon::new(band, LINE_COLOUR.mix(BAND_OPACITY)))?;
        area.draw(&PathElement::new(outline(0.0), LINE_COLOUR.stroke_width(4)))?;
        if samples.len() <= MAX_POINTS_WITH_MARKS && circles.is_none() {
            for sample in samples {
                area.draw(&Circle::new(scale.picture_point(sample.x, sample.y), 7, LINE_COLOUR.filled()))?;
            }
        }
        circles.map_or(Ok(()), |circles| draw_motion_circles(area, &scale, &circles))?;
        draw_ring_labels(area, &scale, number::unit_symbol(function.unit))
    })
}

/// Draws both circles, and a cross at their centre.
fn draw_motion_circles(area: &Area<'_>, scale: &RadiusScale, circles: &MotionCircles) -> DrawResult {
    for value in [circles.inner, circles.outer] {
        let degrees = (0..=180).map(|n| f64::from(n) * MAX_CHORD_DEG);
        let circle: Vec<_> =
            degrees.map(|at| scale.picture_point(at, value + circles.centre_offset_at_angle(at))).collect();
        area.draw(&PathElement::new(circle, FIT_COLOUR.stroke_width(3)))?;
    }
    let [x, y] = circles.centre.map(|value| scale.picture_length(value).round() as i32);
    let (x, y) = (CENTRE_COORDINATE + x, CENTRE_COORDINATE - y);
    let cross = [
        [(x - CENTRE_CROSS_HALF_LENGTH, y), (x + CENTRE_CROSS_HALF_LENGTH, y)],
        [(x, y - CENTRE_CROSS_HALF_LENGTH), (x, y + CENTRE_CROSS_HALF_LENGTH)],
    ];
    for line in cross {
        area.draw(&PathElement::new(line, FIT_COLOUR.stroke_width(4)))?;
    }
    Ok(())
}

fn draw_rings(area: &Area<'_>, scale: &RadiusScale) -> DrawResult {
    let centred = text_style(FONT_SIZE).pos(Pos::new(HPos::Center, VPos::Center));
    for degrees in (0..360).step_by(45).map(f64::from) {
        let spoke = vec![
            polar_to_picture_point(degrees, INNER_RING_RADIUS),
            polar_to_picture_point(degrees, OUTER_RING_RADIUS),
        ];
        area.draw(&PathElement::new(spoke, GRID_COLOUR))?;
        let place = polar_to_picture_point(degrees, OUTER_RING_RADIUS + 44.0);
        area.draw(&Text::new(format!("{degrees}°"), place, centred.clone()))?;
    }
    for value in scale.ring_values() {
        let is_zero = value.abs() < scale.ring_step / 2.0;
        let style = if is_zero { INK_COLOUR.stroke_width(2) } else { GRID_COLOUR.stroke_width(2) };
        let radius = scale.picture_radius(value).round() as i32;
        area.draw(&Circle::new((CENTRE_COORDINATE, CENTRE_COORDINATE), radius, style))?;
    }
    Ok(())
}

/// Draws the labels of the scale rings, above all curves.
fn draw_ring_labels(area: &Area<'_>, scale: &RadiusScale, unit: &str) -> DrawResult {
    let style = text_style(0.9 * FONT_SIZE).pos(Pos::new(HPos::Left, VPos::Center));
    for value in scale.ring_values() {
        let text = format!("{} {unit}", tick_label(value, scale.ring_step));
        area.draw(&Text::new(text, polar_to_picture_point(67.5, scale.picture_radius(value)), style.clone()))?;
    }
    Ok(())
}

/// The closed outline through `samples`, along arcs instead of chords.
fn closed_outline(samples: &[PlotPoint], point: impl Fn(PlotPoint) -> (i32, i32)) -> Vec<(i32, i32)> {
    // The last angle may be beyond one revolution, or equal to the first.
    let turns = |x: f64| (x - samples[0].x) / 360.0;
    let end = 360.0 * samples.last().map_or(0.0, |last| turns(last.x).round());
    let first = samples.first().map(|first| PlotPoint { x: first.x + end, ..*first });
    let next = samples.iter().skip(1).copied().chain(first);
    let mut outline = Vec::new();
    for (from, to) in samples.iter().zip(next) {
        let chords = ((to.x - from.x).abs() / MAX_CHORD_DEG).ceil().clamp(1.0, 360.0);
        let between = |a: f64, b: f64, n: i32| a + (b - a) * f64::from(n) / chords;
        outline.extend((0..=chords as i32).map(|n| {
            let (x, y) = (between(from.x, to.x, n), between(from.y, to.y, n));
            point(PlotPoint {
                x,
                y,
                uncertainty_half_width: between(from.uncertainty_half_width, to.uncertainty_half_width, n),
            })
        }));
    }
    outline
}
