//! Axes with round ticks.

use std::ops::Range;

use jiff::tz::TimeZone;
use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint, Ranged};
use plotters::coord::types::RangedCoordf64;

use super::FONT_SIZE;
use super::time_axis::{TimeTick, time_ticks, zone_name};
use crate::report::number;

/// Maximum number of tick intervals.
const MAX_TICK_INTERVALS: f64 = 8.0;

/// Minimum width of the labels and the title of a y axis. Legends begin at this distance from the left edge.
pub(super) const MIN_Y_LABEL_WIDTH: u32 = 140;
/// Width of the title of a y axis, with its distance to the labels.
const Y_TITLE_WIDTH: u32 = 60;
/// Mean width of a digit, as a share of the font size.
const DIGIT_WIDTH_RATIO: f64 = 0.52;

/// A straight axis with a tick at every multiple of `tick_step`.
#[derive(Clone)]
pub(super) struct TickedAxis {
    plotters_range: RangedCoordf64,
    tick_step: f64,
    /// Ticks of a time axis, in place of those at multiples of `tick_step`.
    time_ticks: Vec<TimeTick>,
    /// Quantity and unit, beside the axis.
    pub(super) title: String,
    /// Minimum width for the labels and the title of a y axis, in picture units.
    min_label_width: u32,
}

impl TickedAxis {
    pub(super) fn with_tick_step(step: f64, range: Range<f64>) -> Self {
        let (title, time_ticks) = (String::new(), Vec::new());
        Self { plotters_range: range.into(), tick_step: step, time_ticks, title, min_label_width: MIN_Y_LABEL_WIDTH }
    }

    /// An axis with the finest round step that gives at most [`MAX_TICK_INTERVALS`] intervals.
    pub(super) fn with_round_ticks(range: Range<f64>) -> Self {
        Self::with_tick_step(round_up_to_1_2_or_5((range.end - range.start) / MAX_TICK_INTERVALS), range)
    }

    /// As [`Self::with_round_ticks`], with half the number of intervals, for a shorter axis.
    pub(super) fn with_coarse_round_ticks(range: Range<f64>) -> Self {
        Self::with_tick_step(round_up_to_1_2_or_5((range.end - range.start) / (MAX_TICK_INTERVALS / 2.0)), range)
    }

    pub(super) fn titled(self, title: &str) -> Self {
        Self { title: title.to_owned(), ..self }
    }

    /// A time axis in Unix seconds with ticks at round local times of this computer.
    pub(super) fn of_local_time(range: Range<f64>) -> Self {
        let zone = TimeZone::system();
        let time_ticks = time_ticks(range.start, range.end, &zone);
        let title = format!("local time ({})", zone_name(&zone, range.end));
        Self { time_ticks, title, ..Self::with_round_ticks(range) }
    }

    /// Widens the labels of this y axis to at least the label width of `other`, so that both plots begin at the same
    /// x.
    pub(super) fn aligned_with(self, other: &Self) -> Self {
        Self { min_label_width: other.label_width(), ..self }
    }

    /// Width of the labels and the title of a y axis, in picture units.
    pub(super) fn label_width(&self) -> u32 {
        let labels = self.key_points(MAX_TICK_INTERVALS as usize).into_iter().map(|value| self.tick_label(value));
        let longest = labels.map(|label| label.chars().count()).max().unwrap_or(0);
        let labels_width = DIGIT_WIDTH_RATIO * FONT_SIZE * longest as f64;
        self.min_label_width.max(labels_width as u32 + Y_TITLE_WIDTH)
    }

    pub(super) fn tick_label(&self, value: f64) -> String {
        match self.time_ticks.iter().find(|tick| tick.t_s == value) {
            Some(tick) => tick.label.clone(),
            None => tick_label(value, self.tick_step),
        }
    }
}

impl Ranged for TickedAxis {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        self.plotters_range.map(value, limit)
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        if !self.time_ticks.is_empty() {
            return self.time_ticks.iter().map(|tick| tick.t_s).collect();
        }
        let Range { start, end } = self.range();
        let (first, last) = ((start / self.tick_step).ceil(), (end / self.tick_step).floor());
        // An axis is too narrow for ticks if its numbers differ in their last digits only.
        let count = (last - first).clamp(-1.0, 2.0 * MAX_TICK_INTERVALS) as i32;
        (0..=count).map(|n| (first + f64::from(n)) * self.tick_step).collect()
    }

    fn range(&self) -> Range<f64> {
        self.plotters_range.range()
    }
}

/// Text of a number on an axis with ticks `step` apart.
pub(super) fn tick_label(value: f64, step: f64) -> String {
    number::format_fixed(value, (-step.log10().floor()).clamp(0.0, 9.0) as usize)
}

/// The round number (1, 2 or 5 times a power of ten) at or above `step`.
pub(super) fn round_up_to_1_2_or_5(step: f64) -> f64 {
    let power = 10f64.powf(step.log10().floor());
    [1.0, 2.0, 5.0].into_iter().map(|m| m * power).find(|s| *s >= step).unwrap_or(10.0 * power)
}

/// Minimum and maximum of `values`; `None` without values.
pub(super) fn value_bounds(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    values.fold(None, |value_bounds, value| {
        let (low, high) = value_bounds.unwrap_or((value, value));
        Some((low.min(value), high.max(value)))
    })
}

/// The range with a margin on either side; never empty.
pub(super) fn add_margin((low, high): (f64, f64)) -> (f64, f64) {
    let span = high - low;
    let room = if span > 0.0 { 0.08 * span } else { low.abs().max(1.0) };
    (low - room, high + room)
}
