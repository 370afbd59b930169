//! Temperatures below a chart, over the same time with a scale of their own. The curve has a gap where a
//! temperature is unknown.

use plotters::prelude::*;

use super::legend::{LegendEntry, LegendSymbol, draw_thermometer_marker};
use super::ticked_axis::{TickedAxis, add_margin, value_bounds};
use super::{Area, DrawResult, LINE_COLOUR};

/// Name of each thermometer, and its temperatures as (time in s, °C), the time as in the chart: Unix time, or since
/// the start of a run. `None`: unknown.
pub type TemperatureCurves = Vec<(String, Vec<(f64, Option<f64>)>)>;

pub(super) const TEMPERATURE_STRIP_HEIGHT: u32 = 330;
/// Minimum range of the temperature scale, K: a smaller range would magnify noise.
const MIN_TEMPERATURE_RANGE_K: f64 = 1.0;

/// Maximum number of marks of a curve; more would hide the line.
const MAX_MARKS_PER_CURVE: usize = 30;

/// Axis of the temperatures; `None` without a value.
pub(super) fn temperature_axis(all: &TemperatureCurves) -> Option<TickedAxis> {
    let known = all.iter().flat_map(|(_, values)| values).filter_map(|(_, celsius)| *celsius);
    let (low, high) = value_bounds(known.filter(|celsius| celsius.is_finite()))?;
    let more = ((MIN_TEMPERATURE_RANGE_K - (high - low)) / 2.0).max(0.0);
    let (low, high) = add_margin((low - more, high + more));
    Some(TickedAxis::with_coarse_round_ticks(low..high).titled("T / °C"))
}

/// Names of the thermometers, for the legend.
pub(super) fn thermometer_legend_entries(all: &TemperatureCurves) -> Vec<LegendEntry> {
    let name = |(number, (name, _)): (usize, &(String, _))| {
        (LegendSymbol::ThermometerMarker(number), format!("temperature {name}"))
    };
    all.iter().enumerate().map(name).collect()
}

/// Draws the strip.
pub(super) fn draw_strip(
    area: &Area<'_>,
    curves: &TemperatureCurves,
    x: TickedAxis,
    seconds_per_x_unit: f64,
    y: TickedAxis,
) -> DrawResult {
    let mut chart = super::draw_axes(area, x, y)?;
    for (number, (_, values)) in curves.iter().enumerate() {
        let point = |(t_s, celsius): &(f64, Option<f64>)| Some((t_s / seconds_per_x_unit, (*celsius)?));
        let unknown = |(_, celsius): &(f64, Option<f64>)| !celsius.is_some_and(f64::is_finite);
        for piece in values.split(unknown) {
            let points: Vec<(f64, f64)> = piece.iter().filter_map(point).collect();
            if points.len() > 1 {
                let line = PathElement::new(points.clone(), LINE_COLOUR.stroke_width(2));
                chart.draw_series([line])?;
            }
            let marks = points.iter().step_by(points.len().div_ceil(MAX_MARKS_PER_CURVE).max(1));
            for point in marks {
                let ((x, y), (left, top)) = (chart.backend_coord(point), area.get_base_pixel());
                draw_thermometer_marker(area, number, (x - left, y - top))?;
            }
        }
    }
    Ok(())
}
