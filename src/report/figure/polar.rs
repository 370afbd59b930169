//! A function of an angle in a polar chart: 0° is to the right, angles count counter-clockwise.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::scale::{bounds, label, round_step, widened};
use super::{Area, BAND, Drawn, FIT, FONT, GRID, INK, LINE, MAX_MARKS, MotionCircles, Sample};
use super::{picture, text_style};
use crate::report::number;
use machine::record::estimate::Function;

const SIDE: u32 = 900;
const CENTRE: i32 = 450;
const OUTER: f64 = 360.0;
/// Radius of the smallest value: the chart magnifies the deviations, not the part.
const INNER: f64 = 120.0;
/// Maximum angle of a chord that approximates an arc, degrees.
const CHORD: f64 = 2.0;
/// Half the length of the mark of a centre.
const CROSS: i32 = 18;

/// Scale from values to radii in the picture.
struct Scale {
    low: f64,
    high: f64,
    step: f64,
}

impl Scale {
    /// Rings at round values that enclose `low..high`.
    fn around(low: f64, high: f64) -> Self {
        let (low, high) = if high > low { (low, high) } else { widened((low, high)) };
        let step = round_step((high - low) / 4.0);
        Self { low: (low / step).floor() * step, high: (high / step).ceil() * step, step }
    }

    fn rings(&self) -> impl Iterator<Item = f64> + '_ {
        let count = ((self.high - self.low) / self.step).round() as i32;
        (0..=count).map(|n| self.low + f64::from(n) * self.step)
    }

    fn radius(&self, value: f64) -> f64 {
        INNER + self.length(value - self.low)
    }

    fn length(&self, difference: f64) -> f64 {
        (OUTER - INNER) * difference / (self.high - self.low)
    }

    fn point(&self, degrees: f64, value: f64) -> (i32, i32) {
        at(degrees, self.radius(value))
    }
}

fn at(degrees: f64, radius: f64) -> (i32, i32) {
    let (sin, cos) = degrees.to_radians().sin_cos();
    (CENTRE + (radius * cos).round() as i32, CENTRE - (radius * sin).round() as i32)
}

pub(super) fn polar(
    function: &Function,
    samples: &[Sample],
    circles: Option<MotionCircles>,
) -> Option<String> {
    let ends = samples.iter().flat_map(|sample| [sample.y - sample.half, sample.y + sample.half]);
    let of_circles = circles.into_iter().flat_map(|circles| {
        let [x, y] = circles.centre;
        [circles.inner - x.hypot(y), circles.outer + x.hypot(y)]
    });
    let (low, high) = bounds(ends.chain(of_circles)).filter(|_| !samples.is_empty())?;
    let scale = Scale::around(low, high);
    let outline = |offset: f64| around(samples, |s| scale.point(s.x, s.y + offset * s.half));
    picture((SIDE, SIDE), |area| {
        rings(area, &scale)?;
        // One ring-shaped area: along the upper bound, and back along the lower.
        let band: Vec<_> =
            outline(1.0).into_iter().chain(outline(-1.0).into_iter().rev()).collect();
        area.draw(&Polygon::new(band, LINE.mix(BAND)))?;
        area.draw(&PathElement::new(outline(0.0), LINE.stroke_width(4)))?;
        if samples.len() <= MAX_MARKS && circles.is_none() {
            for sample in samples {
                area.draw(&Circle::new(scale.point(sample.x, sample.y), 7, LINE.filled()))?;
            }
        }
        circles.map_or(Ok(()), |circles| motion_circles(area, &scale, &circles))?;
        ring_labels(area, &scale, number::unit(function.unit))
    })
}

/// Draws both circles, and a cross at their centre.
fn motion_circles(area: &Area<'_>, scale: &Scale, circles: &MotionCircles) -> Drawn {
    for value in [circles.inner, circles.outer] {
        let degrees = (0..=180).map(|n| f64::from(n) * CHORD);
        let circle: Vec<_> =
            degrees.map(|at| scale.point(at, value + circles.offset(at))).collect();
        area.draw(&PathElement::new(circle, FIT.stroke_width(3)))?;
    }
    let [x, y] = circles.centre.map(|value| scale.length(value).round() as i32);
    let (x, y) = (CENTRE + x, CENTRE - y);
    let cross = [[(x - CROSS, y), (x + CROSS, y)], [(x, y - CROSS), (x, y + CROSS)]];
    for line in cross {
        area.draw(&PathElement::new(line, FIT.stroke_width(4)))?;
    }
    Ok(())
}

fn rings(area: &Area<'_>, scale: &Scale) -> Drawn {
    let centred = text_style(FONT).pos(Pos::new(HPos::Center, VPos::Center));
    for degrees in (0..360).step_by(45).map(f64::from) {
        let spoke = vec![at(degrees, INNER), at(degrees, OUTER)];
        area.draw(&PathElement::new(spoke, GRID))?;
        let place = at(degrees, OUTER + 44.0);
        area.draw(&Text::new(format!("{degrees}°"), place, centred.clone()))?;
    }
    for value in scale.rings() {
        let is_zero = value.abs() < scale.step / 2.0;
        let style = if is_zero { INK.stroke_width(2) } else { GRID.stroke_width(2) };
        let radius = scale.radius(value).round() as i32;
        area.draw(&Circle::new((CENTRE, CENTRE), radius, style))?;
    }
    Ok(())
}

/// Draws the labels of the rings, above all curves.
fn ring_labels(area: &Area<'_>, scale: &Scale, unit: &str) -> Drawn {
    let style = text_style(0.9 * FONT).pos(Pos::new(HPos::Left, VPos::Center));
    for value in scale.rings() {
        let text = format!("{} {unit}", label(value, scale.step));
        area.draw(&Text::new(text, at(67.5, scale.radius(value)), style.clone()))?;
    }
    Ok(())
}

/// The closed outline through `samples`, along arcs instead of chords.
fn around(samples: &[Sample], point: impl Fn(Sample) -> (i32, i32)) -> Vec<(i32, i32)> {
    // The last angle may be beyond one revolution, or equal to the first.
    let turns = |x: f64| (x - samples[0].x) / 360.0;
    let end = 360.0 * samples.last().map_or(0.0, |last| turns(last.x).round());
    let first = samples.first().map(|first| Sample { x: first.x + end, ..*first });
    let next = samples.iter().skip(1).copied().chain(first);
    let mut outline = Vec::new();
    for (from, to) in samples.iter().zip(next) {
        let chords = ((to.x - from.x).abs() / CHORD).ceil().clamp(1.0, 360.0);
        let between = |a: f64, b: f64, n: i32| a + (b - a) * f64::from(n) / chords;
        outline.extend((0..=chords as i32).map(|n| {
            let (x, y) = (between(from.x, to.x, n), between(from.y, to.y, n));
            point(Sample { x, y, half: between(from.half, to.half, n) })
        }));
    }
    outline
}
