//! Trend of a value over the runs of a machine: its control limits, its steps and drifts, when they happened
//! and how certain they are. Values have the unit of their estimates; only their order, their scatter and the
//! time between them are used here.

mod change_detection;
mod clock_correction;
mod control_charts;
mod trend_description;

use serde::Serialize;

pub use change_detection::{Change, ChangeKind};
pub use control_charts::{EwmaChart, IndividualsChart};
pub use trend_description::{NamedTrend, describe_changes};

/// Value of one run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrendPoint {
    /// Time of the measurement, s from any origin.
    pub measurement_time_s: f64,
    pub value: f64,
}

/// The history of one value.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Trend {
    /// Points, oldest first, with non-decreasing times.
    #[serde(skip)]
    pub points: Vec<TrendPoint>,
    /// Changes, oldest first, with increasing times.
    pub changes: Vec<Change>,
    /// Control limits from the values since the last step. The newest value is excluded, because the limits
    /// judge it. `None`: fewer than [`MIN_CHART_VALUES`] such values.
    pub individuals: Option<IndividualsChart>,
    /// EWMA chart of the values since the last step, the newest value included, with centre and scatter of
    /// `individuals`. `None`: as `individuals`.
    pub ewma: Option<EwmaChart>,
}

/// Minimum number of values for control limits; with fewer the scatter is too uncertain.
pub const MIN_CHART_VALUES: usize = 8;

impl Trend {
    /// The trend of `points` in the order in which they were measured, whatever the clock showed. A time that
    /// does not fit this order is replaced by that of the point before it. Values must be finite.
    pub fn from_points(mut points: Vec<TrendPoint>) -> Self {
        clock_correction::correct_times(&mut points);
        let changes = change_detection::detect_changes(&points);
        let begins = changes.iter().filter(|change| change.kind == ChangeKind::Step).map(|c| c.first);
        let values: Vec<f64> = points.iter().map(|point| point.value).collect();
        let regime = values.get(begins.max().unwrap_or(0)..).unwrap_or_default();
        let before = regime.split_last().map_or(&[][..], |(_, before)| before);
        let individuals = (before.len() >= MIN_CHART_VALUES).then(|| IndividualsChart::from_values(before)).flatten();
        let ewma = individuals.map(|chart| EwmaChart::from_values(regime, chart.centre, chart.sigma));
        Self { points, changes, individuals, ewma }
    }

    /// Whether the newest value, or the moving average up to it, lies outside the limits from the earlier values.
    /// `None`: there are no limits.
    pub fn is_newest_value_outside_limits(&self) -> Option<bool> {
        let chart = self.individuals?;
        let newest = self.points.last()?;
        let by_ewma = self.ewma.as_ref().is_some_and(EwmaChart::is_newest_mean_outside_limits);
        Some(!chart.is_within_limits(newest.value) || by_ewma)
    }
}

#[cfg(test)]
mod tests;
