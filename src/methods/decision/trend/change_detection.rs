//! Detection of steps and drifts in a series. A possible change is a step between two runs, or a line that
//! begins at a run; each explains a part of the scatter. The change that explains most is compared with the
//! best explanation of random series, by simulation.

use rand_distr::{Distribution, StandardNormal};

use serde::Serialize;

use super::TrendPoint;
use estimation::coverage;
use estimation::random::seeded_stream;

/// Minimum number of values on each side of a step: a single value may be an outlier.
const MIN_VALUES_PER_STEP_SIDE: usize = 2;
/// Minimum number of values after the first value of a drift.
const MIN_VALUES_AFTER_DRIFT_START: usize = 3;
/// Series with fewer values are not searched for changes.
pub(super) const MIN_CHANGE_DETECTION_VALUES: usize = 6;
/// Only the newest values, at most this number, are evaluated.
const MAX_EVALUATED_VALUES: usize = 100;
/// Significance level: a change is reported if at most this fraction of random series contains a change that explains
/// as much. It is small, because a parameter that is checked daily for years must not give frequent false alarms.
const SIGNIFICANCE_LEVEL: f64 = 0.001;
const SIMULATED_SERIES_COUNT: u32 = 4999;
/// Probability of the interval in which a change happened.
const CHANGE_TIME_COVERAGE_PROBABILITY: f64 = 0.95;
const SECONDS_PER_DAY: f64 = 86_400.0;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ChangeKind {
    /// A step between two successive runs.
    Step,
    /// A line that begins at a run.
    Drift,
}

/// A change that random scatter does not explain.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Change {
    pub kind: ChangeKind,
    /// Height of a step; change per day of a drift.
    pub by: f64,
    /// Expanded uncertainty of `by`.
    #[serde(rename = "U")]
    pub expanded: f64,
    /// Index, among all points of the trend, of the first value after the step, or of the value at which the line
    /// begins.
    pub first: usize,
    /// Index of the last value before the 95 % interval of the change, and of the first after it.
    pub between: [usize; 2],
    /// Probability that random scatter explains as much of the scatter as this change.
    #[serde(rename = "chance")]
    pub p_value: f64,
}

/// The changes in `points` (ordered), oldest first: the most significant change, and, if it is a step, the changes
/// after it. Values before a step are not searched again.
pub(super) fn detect_changes(points: &[TrendPoint]) -> Vec<Change> {
    let mut changes: Vec<Change> = Vec::new();
    let mut begin = points.len().saturating_sub(MAX_EVALUATED_VALUES);
    while let Some(found) = points.get(begin..).and_then(most_significant_change) {
        let [before, after] = found.between;
        let change = Change { first: found.first + begin, between: [before + begin, after + begin], ..found };
        begin = change.first;
        let ends = change.kind == ChangeKind::Drift;
        changes.push(change);
        if ends {
            break;
        }
    }
    changes
}

/// One possible change as a function of the values' index, with mean zero.
struct CandidateChange {
    kind: ChangeKind,
    /// First value after the step, or value at which the line begins.
    first_index: usize,
    /// Step of height 1, or line of slope 1 per day, minus its mean.
    shape_column: Vec<f64>,
    shape_norm: f64,
}

impl CandidateChange {
    fn new(kind: ChangeKind, first: usize, column: Vec<f64>) -> Self {
        let mean = column.iter().sum::<f64>() / column.len() as f64;
        let column: Vec<f64> = column.into_iter().map(|value| value - mean).collect();
        let norm = column.iter().map(|value| value * value).sum::<f64>().sqrt();
        Self { kind, first_index: first, shape_column: column, shape_norm: norm }
    }

    /// Reduction of Σ(value − mean)² by the change.
    fn explained_squares(&self, values: &[f64]) -> f64 {
        (self.projection(values) / self.shape_norm).powi(2)
    }

    fn projection(&self, values: &[f64]) -> f64 {
        self.shape_column.iter().zip(values).map(|(column, value)| column * value).sum()
    }

    /// Index of the last value before the change, and of the first after it.
    fn bounding_indices(&self) -> [usize; 2] {
        match self.kind {
            ChangeKind::Step => [self.first_index - 1, self.first_index],
            ChangeKind::Drift => [self.first_index, self.first_index + 1],
        }
    }
}

fn candidate_changes(days: &[f64]) -> Vec<CandidateChange> {
    let count = days.len();
    let step = |first: usize| {
        let column = (0..count).map(|i| f64::from(u8::from(i >= first))).collect();
        CandidateChange::new(ChangeKind::Step, first, column)
    };
    let line = |first: usize| {
        let column = days.iter().map(|day| (day - days[first]).max(0.0)).collect();
        CandidateChange::new(ChangeKind::Drift, first, column)
    };
    let steps = (MIN_VALUES_PER_STEP_SIDE..=count - MIN_VALUES_PER_STEP_SIDE).map(step);
    let lines = (0..count - MIN_VALUES_AFTER_DRIFT_START).map(line);
    steps.chain(lines).filter(|possible| possible.shape_norm > 0.0).collect()
}

/// `None`: too few values, scatter by rounding only, or no change at `SIGNIFICANCE_LEVEL`.
fn most_significant_change(points: &[TrendPoint]) -> Option<Change> {
    if points.len() < MIN_CHANGE_DETECTION_VALUES {
        return None;
    }
    let origin = points.first()?.measurement_time_s;
    let days: Vec<f64> = points.iter().map(|point| (point.measurement_time_s - origin) / SECONDS_PER_DAY).collect();
    let values: Vec<f64> = points.iter().map(|point| point.value).collect();
    let all = candidate_changes(&days);
    let scatter = squared_deviation_sum(&values);
    let size = values.iter().map(|value| value * value).sum::<f64>();
    // The scatter is rounding only.
    if scatter <= f64::EPSILON.powi(2) * size * values.len() as f64 {
        return None;
    }
    let best =
        all.iter().max_by(|one, other| one.explained_squares(&values).total_cmp(&other.explained_squares(&values)))?;
    let chance = simulated_p_value(&all, values.len(), best.explained_squares(&values) / scatter)?;
    (chance <= SIGNIFICANCE_LEVEL).then(|| change_from_candidate(&all, best, &values, chance))
}

/// Sum of squares: Σ(value − mean)².
fn squared_deviation_sum(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter().map(|value| (value - mean).powi(2)).sum()
}

/// Fraction of random normal series without a change in which the best of these changes explains `share` of
/// the scatter. `None` as soon as the fraction is certainly too large.
fn simulated_p_value(all: &[CandidateChange], count: usize, share: f64) -> Option<f64> {
    let most = (SIGNIFICANCE_LEVEL * f64::from(SIMULATED_SERIES_COUNT + 1)) as u32;
    let mut rng = seeded_stream(0, &[count as u64]);
    let (mut as_much, mut draw) = (0, vec![0.0; count]);
    for _ in 0..SIMULATED_SERIES_COUNT {
        draw.fill_with(|| StandardNormal.sample(&mut rng));
        let enough = share * squared_deviation_sum(&draw);
        as_much += u32::from(all.iter().any(|possible| possible.explained_squares(&draw) >= enough));
        if as_much >= most {
            return None;
        }
    }
    Some(f64::from(as_much + 1) / f64::from(SIMULATED_SERIES_COUNT + 1))
}

/// The change with its fitted size, and the interval of candidates of its kind that explain the values almost as
/// well.
fn change_from_candidate(all: &[CandidateChange], best: &CandidateChange, values: &[f64], chance: f64) -> Change {
    // Level, height and position of the change are fitted to the values.
    let dof = (values.len() - 3) as f64;
    let left =
        |possible: &CandidateChange| (squared_deviation_sum(values) - possible.explained_squares(values)).max(0.0);
    let least = left(best);
    let u = (least / dof).sqrt() / best.shape_norm;
    let bound = least * (1.0 + coverage::two_sided_t_factor(CHANGE_TIME_COVERAGE_PROBABILITY, dof).powi(2) / dof);
    let may = all.iter().filter(|other| other.kind == best.kind && left(other) <= bound);
    let [mut before, mut after] = best.bounding_indices();
    for [earlier, later] in may.map(CandidateChange::bounding_indices) {
        (before, after) = (before.min(earlier), after.max(later));
    }
    Change {
        kind: best.kind,
        by: best.projection(values) / best.shape_norm.powi(2),
        expanded: coverage::coverage_factor(dof) * u,
        first: best.first_index,
        between: [before, after],
        p_value: chance,
    }
}
