//! How a value goes over a machine's runs: its control limits, and the steps and drifts in it with
//! since-when and how sure. Values have the unit of their estimates; only their order, their scatter
//! and the time between them count here.

mod change;
mod chart;
mod order;
mod words;

use serde::Serialize;

pub use change::{Change, Kind};
pub use chart::{Ewma, Individuals};
pub use words::{Told, what_changed};

/// One run's value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// When it was measured, s from any origin.
    pub t_s: f64,
    pub value: f64,
}

/// The history of one value.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Trend {
    /// Oldest first; none is of an earlier time than the one before.
    #[serde(skip)]
    pub points: Vec<Point>,
    /// Oldest first; each is later than the one before.
    pub changes: Vec<Change>,
    /// From what came since the last step, the newest value left out: it is judged by them. `None` with
    /// fewer than [`FEWEST`] such values.
    pub individuals: Option<Individuals>,
    /// Over the same values and the newest one.
    pub ewma: Option<Ewma>,
}

/// Fewer values than these have no control limits: their scatter is not known well enough.
pub const FEWEST: usize = 8;

impl Trend {
    /// Of `points` in the order in which they were measured, whatever the clock said; a time that does not
    /// fit this order becomes that of the point before it. Values are finite.
    pub fn of(mut points: Vec<Point>) -> Self {
        order::mend(&mut points);
        let changes = change::changes(&points);
        let begins = changes.iter().filter(|change| change.kind == Kind::Step).map(|c| c.first);
        let values: Vec<f64> = points.iter().map(|point| point.value).collect();
        let regime = values.get(begins.max().unwrap_or(0)..).unwrap_or_default();
        let before = regime.split_last().map_or(&[][..], |(_, before)| before);
        let individuals = (before.len() >= FEWEST).then(|| Individuals::of(before)).flatten();
        let ewma = individuals.map(|chart| Ewma::of(regime, chart.centre, chart.sigma));
        Self { points, changes, individuals, ewma }
    }

    /// Whether the newest value lies outside the limits that those before it set.
    pub fn is_out(&self) -> Option<bool> {
        let chart = self.individuals?;
        let newest = self.points.last()?;
        let by_ewma = self.ewma.as_ref().is_some_and(Ewma::is_out);
        Some(!chart.holds(newest.value) || by_ewma)
    }
}

#[cfg(test)]
mod tests;
