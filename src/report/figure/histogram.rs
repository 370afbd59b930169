//! Histogram of values, with the normal distribution of the same mean and standard deviation. For values that
//! are never negative, such as lengths, the normal distribution is left out.

use std::f64::consts::TAU;

use plotters::prelude::*;

use super::ticked_axis::{TickedAxis, round_up_to_1_2_or_5, value_bounds};
use super::{FIT_COLOUR, LINE_COLOUR, PICTURE_SIZE, PlotPoint, draw_picture};
use crate::report::number;
use machine::record::estimate::EstimatedFunction;

/// Maximum ratio of the range of the values to the width of a column; more columns would show no further detail.
const MAX_RANGE_TO_BIN_WIDTH_RATIO: f64 = 60.0;

pub(super) fn draw_histogram(function: &EstimatedFunction, samples: &[PlotPoint]) -> Option<String> {
    let values: Vec<f64> = samples.iter().map(|sample| sample.y).collect();
    let columns = HistogramBins::from_values(&values)?;
    let tallest = columns.counts.iter().copied().max()?;
    let normal = columns.expected_normal_counts(&values);
    let top = normal.iter().map(|(_, count)| *count).fold(tallest as f64, f64::max);
    let unit = function.unit.symbol();
    let x_name = format!("{} / {unit}", number::one_line_symbol(&function.symbol));
    let x_axis = TickedAxis::with_round_ticks(columns.bin_edge(0)..columns.bin_edge(columns.counts.len()));
    draw_picture(PICTURE_SIZE, |area| {
        let y_axis = TickedAxis::with_round_ticks(0.0..1.08 * top);
        let mut chart = super::draw_axes(area, x_axis.titled(&x_name), y_axis.titled("count"))?;
        chart.draw_series(columns.counts.iter().enumerate().map(|(i, count)| {
            let corners = [(columns.bin_edge(i), *count as f64), (columns.bin_edge(i + 1), 0.0)];
            Rectangle::new(corners, LINE_COLOUR.mix(0.6).filled())
        }))?;
        if !are_all_nonnegative(samples) {
            chart.draw_series([PathElement::new(normal, FIT_COLOUR.stroke_width(4))])?;
        }
        Ok(())
    })
}

fn are_all_nonnegative(samples: &[PlotPoint]) -> bool {
    samples.iter().all(|sample| sample.y >= 0.0)
}

/// Columns of equal width, each with the number of its values.
struct HistogramBins {
    /// Lower edge of the first column.
    first_edge: f64,
    bin_width: f64,
    counts: Vec<usize>,
}

impl HistogramBins {
    /// Columns of a round width, by the rule of Freedman and Diaconis (1981): twice the interquartile range
    /// over the cube root of the count.
    fn from_values(values: &[f64]) -> Option<Self> {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let (low, high) = value_bounds(sorted.iter().copied())?;
        let at = |quarter: usize| sorted.get(quarter * (sorted.len() - 1) / 4).copied();
        let wanted = 2.0 * (at(3)? - at(1)?) / (sorted.len() as f64).cbrt();
        let least = (high - low) / MAX_RANGE_TO_BIN_WIDTH_RATIO;
        // Equal values give one column.
        let alike = if low == 0.0 { 1.0 } else { 1e-3 * low.abs() };
        let width = [wanted.max(least), alike].into_iter().find(|width| *width > 0.0)?;
        let width = round_up_to_1_2_or_5(width);
        let first = (low / width).floor() * width;
        let place = |value: f64| ((value - first) / width) as usize;
        let mut counts = vec![0; place(high) + 1];
        for value in sorted {
            if let Some(count) = counts.get_mut(place(value)) {
                *count += 1;
            }
        }
        Some(Self { first_edge: first, bin_width: width, counts })
    }

    /// Lower edge of the column with this index, and upper edge of the column before it.
    fn bin_edge(&self, number: usize) -> f64 {
        self.first_edge + self.bin_width * number as f64
    }

    /// Position, and expected count of a column centred there, for the normal distribution with the mean and standard
    /// deviation of `values`; empty if all are equal.
    fn expected_normal_counts(&self, values: &[f64]) -> Vec<(f64, f64)> {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let square = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
        let sd = (square / (n - 1.0)).sqrt();
        if !(sd > 0.0 && sd.is_finite()) {
            return Vec::new();
        }
        let (low, high) = (self.bin_edge(0), self.bin_edge(self.counts.len()));
        let at = |step: i32| {
            let x = low + (high - low) * f64::from(step) / 200.0;
            let height = (-0.5 * ((x - mean) / sd).powi(2)).exp() / (sd * TAU.sqrt());
            (x, n * self.bin_width * height)
        };
        (0..=200).map(at).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_is_in_one_bin() {
        // Quartiles 1 apart, 8 values: columns 1 wide.
        let values = [0.1, 0.2, 0.9, 1.0, 1.1, 1.15, 1.9, 2.5];
        let columns = HistogramBins::from_values(&values).unwrap();
        assert_eq!((columns.first_edge, columns.bin_width), (0.0, 1.0));
        assert_eq!(columns.counts, [3, 4, 1]);
        let normal = columns.expected_normal_counts(&values);
        // The range covers nearly the whole normal distribution; its tails are not drawn.
        let step = 3.0 / 200.0;
        let area: f64 = normal.iter().map(|(_, count)| count * step).sum();
        assert!((6.9..7.9).contains(&area), "{area}");
        let top = normal.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        let mean = values.iter().sum::<f64>() / 8.0;
        assert!((top.0 - mean).abs() <= step, "{top:?}");
        for alike in [0.0, -3.0, 1e9] {
            assert_eq!(HistogramBins::from_values(&[alike; 5]).unwrap().counts.iter().sum::<usize>(), 5);
        }
        assert!(HistogramBins::from_values(&[]).is_none());
        let one_far = [vec![0.0; 1000], vec![1e6]].concat();
        assert!(HistogramBins::from_values(&one_far).unwrap().counts.len() <= 61);
    }
}
