//! Temperatures over the time of one run.

use super::legend;
use super::temperature_strip::{self, TemperatureCurves};
use super::ticked_axis::{TickedAxis, add_margin, value_bounds};
use super::{MIN_Y_LABEL_WIDTH, PICTURE_SIZE, draw_picture};

const SECONDS_PER_MINUTE: f64 = 60.0;

/// Draws the temperatures over the time since the start of the run; `None` without a temperature.
pub(in crate::report) fn draw_run_temperatures(curves: &TemperatureCurves) -> Option<String> {
    let y = temperature_strip::temperature_axis(curves)?;
    let times = curves.iter().flat_map(|(_, values)| values).map(|(t_s, _)| t_s / SECONDS_PER_MINUTE);
    let (first, last) = value_bounds(times.filter(|time| time.is_finite()))?;
    let (first, last) = if last > first { (first, last) } else { add_margin((first, last)) };
    let time = TickedAxis::with_round_ticks(first..last).titled("time / min");
    let names = temperature_strip::thermometer_legend_entries(curves);
    let legend_height = legend::legend_height(&names, MIN_Y_LABEL_WIDTH, PICTURE_SIZE.0);
    draw_picture((PICTURE_SIZE.0, PICTURE_SIZE.1 + legend_height), |area| {
        let (above, below) = area.split_vertically(legend_height as i32);
        legend::draw_legend(&above, MIN_Y_LABEL_WIDTH, &names)?;
        temperature_strip::draw_strip(&below, curves, time, SECONDS_PER_MINUTE, y)
    })
}
