//! Figures as SVG text, one kind per file. Sizes are in SVG units; the report page scales them.

use plotters::coord::Shift;
use plotters::coord::ranged1d::Ranged;
use plotters::prelude::*;

use self::ticked_axis::{MIN_Y_LABEL_WIDTH, TickedAxis};
use machine::record::estimate::{EstimatedFunction, FunctionFigureKind};

mod arrow_scales;
mod arrows;
mod axis_sketch;
mod circle;
mod compact_svg;
mod curve;
mod error_map;
mod error_motion;
mod full_turn;
mod histogram;
mod individuals;
mod legend;
mod matrix;
mod paths;
mod points;
mod polar;
mod run_temperatures;
mod spectrum;
mod temperature_strip;
#[cfg(test)]
mod tests;
mod ticked_axis;
mod time_axis;
mod views;

pub(super) use arrow_scales::{ArrowScales, group_rms};
pub(super) use axis_sketch::{AxisSketch, axes_with_location_errors};
pub(super) use circle::draw_circle;
pub(super) use compact_svg::compact_svg;
pub(super) use curve::argument_name;
pub use error_map::ErrorMap;
pub(super) use error_motion::{MotionCentre, MotionCircles};
pub(super) use full_turn::RemovedCircle;
pub use individuals::IndividualsChart;
pub(super) use matrix::{MIN_SHOWN_COEFFICIENT, correlation_coefficient, draw_matrix};
pub(super) use points::draw_points_with_circles;
pub(super) use run_temperatures::draw_run_temperatures;
pub use temperature_strip::TemperatureCurves;

/// Text, axes and reference lines. The report page's style sheet replaces the exact values of this and the following
/// colours in dark mode.
const INK_COLOUR: RGBColor = RGBColor(0x22, 0x26, 0x2B);
/// Grid lines, frames and shaded areas.
const GRID_COLOUR: RGBColor = RGBColor(0xD5, 0xD9, 0xDE);
/// Measured or estimated values, and their uncertainty bands.
const LINE_COLOUR: RGBColor = RGBColor(0x1F, 0x6F, 0xB2);
/// Fitted shapes, limits, and marks that must be seen, such as flagged values.
const FIT_COLOUR: RGBColor = RGBColor(0xC2, 0x57, 0x1A);
/// Opacity of an uncertainty band.
const BAND_OPACITY: f64 = 0.22;
const FONT_SIZE: f64 = 36.0;
/// Size of a picture with two straight axes. The report shows it at least 330 px wide, where its labels are 9 px high.
const PICTURE_SIZE: (u32, u32) = (1000, 560);
const PICTURE_MARGIN: u32 = 24;
const X_LABEL_HEIGHT: u32 = 96;
/// Maximum number of points with marks; more marks would hide the line.
const MAX_POINTS_WITH_MARKS: usize = 100;

/// A point of a function: argument, value, half-width of the uncertainty band.
#[derive(Debug, Clone, Copy)]
struct PlotPoint {
    x: f64,
    y: f64,
    /// k·u; 0 if u is not stated.
    uncertainty_half_width: f64,
}

impl PlotPoint {
    fn coordinates(&self) -> (f64, f64) {
        (self.x, self.y)
    }

    /// Lower and upper end of the uncertainty band.
    fn uncertainty_ends(&self) -> [f64; 2] {
        [self.y - self.uncertainty_half_width, self.y + self.uncertainty_half_width]
    }
}

/// A function with the kind of its figure and the data to draw.
pub(super) struct FunctionFigure<'a> {
    function: &'a EstimatedFunction,
    /// Finite points of the function, less `removed_circle`.
    samples: Vec<PlotPoint>,
    /// Kind that is drawn; it may differ from the kind in the estimate.
    pub(super) kind: FunctionFigureKind,
    /// Circle that is subtracted from a polar figure.
    pub(super) removed_circle: Option<RemovedCircle>,
    /// Centre and circles of a polar figure of an error motion.
    pub(super) error_motion_circles: Option<(MotionCentre, MotionCircles)>,
}

impl<'a> FunctionFigure<'a> {
    /// `k`: coverage factor of the band ±k·u.
    pub(super) fn new(function: &'a EstimatedFunction, k: f64) -> Self {
        let mut samples = finite_plot_points(function, k);
        let kind = full_turn::kind_by_data(function, &samples);
        let is_polar = kind == FunctionFigureKind::Polar;
        let removed = is_polar.then(|| full_turn::eccentricity_to_remove(function, &samples)).flatten();
        if let Some(circle) = removed {
            samples.iter_mut().for_each(|sample| sample.y -= circle.value_at(sample.x));
        }
        let motion = is_polar.then(|| error_motion_circles(function, &samples)).flatten();
        Self { function, samples, kind, removed_circle: removed, error_motion_circles: motion }
    }

    /// Value of one division of the scale of a polar figure, in the unit of the function.
    pub(super) fn polar_division(&self) -> Option<f64> {
        (self.kind == FunctionFigureKind::Polar).then(|| polar::division_value(self)).flatten()
    }

    /// The picture; `None` without a finite value.
    pub(super) fn draw(&self) -> Option<String> {
        let Self { function, samples, .. } = self;
        match self.kind {
            FunctionFigureKind::Curve => curve::draw_curve(function, samples),
            FunctionFigureKind::Polar => polar::draw_polar(self),
            FunctionFigureKind::Points => points::draw_points(function, samples, &[]),
            FunctionFigureKind::Histogram => histogram::draw_histogram(function, samples),
            FunctionFigureKind::Spectrum => spectrum::draw_spectrum(function, samples),
        }
    }
}

/// Draws `function` with the band ±`k`·u. `None` if it has no finite value.
pub(super) fn draw_function(function: &EstimatedFunction, k: f64) -> Option<String> {
    FunctionFigure::new(function, k).draw()
}

fn error_motion_circles(function: &EstimatedFunction, samples: &[PlotPoint]) -> Option<(MotionCentre, MotionCircles)> {
    let centre = MotionCentre::from_symbol(&function.symbol)?;
    Some((centre, MotionCircles::new(samples, centre)?))
}

/// Finite values of the function.
fn finite_plot_points(function: &EstimatedFunction, k: f64) -> Vec<PlotPoint> {
    let points = function.x.iter().zip(&function.y);
    points
        .zip(function.u.iter().copied().chain(std::iter::repeat(0.0)))
        .map(|((x, y), u)| PlotPoint { x: *x, y: *y, uncertainty_half_width: finite_or_zero(k * u) })
        .filter(|sample| sample.x.is_finite() && sample.y.is_finite())
        .collect()
}

fn finite_or_zero(value: f64) -> f64 {
    if value.is_finite() { value } else { 0.0 }
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type DrawResult = Result<(), Box<dyn std::error::Error>>;

/// Draws a picture by `draw`. The result has no size of its own, so that the report page can scale it. `None` only if
/// the drawing library fails, which is not expected when it writes to memory.
fn draw_picture((width, height): (u32, u32), draw: impl for<'a> FnOnce(&Area<'a>) -> DrawResult) -> Option<String> {
    let mut svg = String::new();
    let area = SVGBackend::with_string(&mut svg, (width, height)).into_drawing_area();
    let drawn = draw(&area).is_ok() && area.present().is_ok();
    drop(area);
    let sized = format!("<svg width=\"{width}\" height=\"{height}\"");
    drawn.then(|| svg.replacen(&sized, "<svg role=\"img\" aria-label=\"figure\"", 1))
}

type Chart<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<TickedAxis, TickedAxis>>;

/// A chart with its axes drawn, with their titles.
fn draw_axes<'a>(area: &Area<'a>, x: TickedAxis, y: TickedAxis) -> Result<Chart<'a>, Box<dyn std::error::Error>> {
    let mut chart = ChartBuilder::on(area)
        .margin(PICTURE_MARGIN)
        .margin_right(2 * PICTURE_MARGIN)
        .x_label_area_size(X_LABEL_HEIGHT)
        .y_label_area_size(y.label_width())
        .build_cartesian_2d(x.clone(), y.clone())?;
    chart
        .configure_mesh()
        // The grid shows the ticks; their marks would double the number of shapes.
        .axis_style(TRANSPARENT)
        .bold_line_style(GRID_COLOUR)
        .light_line_style(TRANSPARENT)
        .x_label_formatter(&|value| x.tick_label(*value))
        .y_label_formatter(&|value| y.tick_label(*value))
        .x_desc(&x.title)
        .y_desc(&y.title)
        .label_style(text_style(FONT_SIZE))
        .axis_desc_style(text_style(1.1 * FONT_SIZE))
        .draw()?;
    let ([left, right], [bottom, top]) = ([x.range().start, x.range().end], [y.range().start, y.range().end]);
    chart
        .draw_series([PathElement::new([(left, top), (left, bottom), (right, bottom)], INK_COLOUR.stroke_width(2))])?;
    Ok(chart)
}

fn text_style<'a>(size: f64) -> TextStyle<'a> {
    ("sans-serif", size).into_font().color(&INK_COLOUR)
}
