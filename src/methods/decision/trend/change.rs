//! Steps and drifts in a series. Each possible change, a step between two runs or a line that begins at
//! one, explains a part of the scatter; the one that explains most is compared with what chance explains
//! at best among the same possibilities, by drawing.

use rand_distr::{Distribution, StandardNormal};

use serde::Serialize;

use super::Point;
use estimation::coverage;
use estimation::random::stream;

/// Values on each side of a step, and of a line after its beginning: one alone may be a slip.
const SIDE: usize = 2;
const LINE: usize = 3;
/// With fewer values nothing can be told.
pub(super) const SERIES: usize = 6;
/// Only so many of the newest are looked at.
const WINDOW: usize = 100;
/// A change is told when chance brings as much in fewer than so many of the draws: a parameter that is
/// looked at every day for years must not cry wolf.
const CHANCE: f64 = 0.001;
const DRAWS: u32 = 4999;
/// When it happened, with this probability.
const WHEN: f64 = 0.95;
const DAY_S: f64 = 86_400.0;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// From one run to the next.
    Step,
    /// A line from some run on.
    Drift,
}

/// A change that chance does not explain.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Change {
    pub kind: Kind,
    /// Of a step its height; of a drift what it makes in a day.
    pub by: f64,
    /// Expanded uncertainty of `by`.
    #[serde(rename = "U")]
    pub expanded: f64,
    /// Index of the first value after the step; of that at which the line begins.
    pub first: usize,
    /// Indices of the last value that was surely before, and of the first that is surely after.
    pub between: [usize; 2],
    /// How often chance brings as much.
    pub chance: f64,
}

/// The changes in `points` (ordered), oldest first: after a step what came since is looked at by itself.
pub(super) fn changes(points: &[Point]) -> Vec<Change> {
    let mut changes: Vec<Change> = Vec::new();
    let mut begin = points.len().saturating_sub(WINDOW);
    while let Some(found) = points.get(begin..).and_then(largest) {
        let [before, after] = found.between;
        let change = Change {
            first: found.first + begin,
            between: [before + begin, after + begin],
            ..found
        };
        begin = change.first;
        let ends = change.kind == Kind::Drift;
        changes.push(change);
        if ends {
            break;
        }
    }
    changes
}

/// One possible change as a column, its mean taken out, over the values.
struct Possible {
    kind: Kind,
    first: usize,
    column: Vec<f64>,
    norm: f64,
}

impl Possible {
    fn new(kind: Kind, first: usize, column: Vec<f64>) -> Self {
        let mean = column.iter().sum::<f64>() / column.len() as f64;
        let column: Vec<f64> = column.into_iter().map(|value| value - mean).collect();
        let norm = column.iter().map(|value| value * value).sum::<f64>().sqrt();
        Self { kind, first, column, norm }
    }

    /// Of Σ(value − mean)², by how much it grows less.
    fn explains(&self, values: &[f64]) -> f64 {
        (self.along(values) / self.norm).powi(2)
    }

    fn along(&self, values: &[f64]) -> f64 {
        self.column.iter().zip(values).map(|(column, value)| column * value).sum()
    }

    /// The last index before and the first after.
    fn between(&self) -> [usize; 2] {
        match self.kind {
            Kind::Step => [self.first - 1, self.first],
            Kind::Drift => [self.first, self.first + 1],
        }
    }
}

fn possible(days: &[f64]) -> Vec<Possible> {
    let count = days.len();
    let step = |first: usize| {
        let column = (0..count).map(|i| f64::from(u8::from(i >= first))).collect();
        Possible::new(Kind::Step, first, column)
    };
    let line = |first: usize| {
        let column = days.iter().map(|day| (day - days[first]).max(0.0)).collect();
        Possible::new(Kind::Drift, first, column)
    };
    let steps = (SIDE..=count - SIDE).map(step);
    let lines = (0..count - LINE).map(line);
    steps.chain(lines).filter(|possible| possible.norm > 0.0).collect()
}

fn largest(points: &[Point]) -> Option<Change> {
    if points.len() < SERIES {
        return None;
    }
    let origin = points.first()?.t_s;
    let days: Vec<f64> = points.iter().map(|point| (point.t_s - origin) / DAY_S).collect();
    let values: Vec<f64> = points.iter().map(|point| point.value).collect();
    let all = possible(&days);
    let scatter = squares(&values);
    let size = values.iter().map(|value| value * value).sum::<f64>();
    // Nothing but rounding.
    if scatter <= f64::EPSILON.powi(2) * size * values.len() as f64 {
        return None;
    }
    let best = all
        .iter()
        .max_by(|one, other| one.explains(&values).total_cmp(&other.explains(&values)))?;
    let chance = chance(&all, values.len(), best.explains(&values) / scatter)?;
    (chance <= CHANCE).then(|| change(&all, best, &values, chance))
}

/// Σ(value − mean)².
fn squares(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter().map(|value| (value - mean).powi(2)).sum()
}

/// How often normal values without any change have `share` of their scatter explained by the best of
/// these; `None` once it is plain that it is too often.
fn chance(all: &[Possible], count: usize, share: f64) -> Option<f64> {
    let most = (CHANCE * f64::from(DRAWS + 1)) as u32;
    let mut rng = stream(0, &[count as u64]);
    let (mut as_much, mut draw) = (0, vec![0.0; count]);
    for _ in 0..DRAWS {
        draw.fill_with(|| StandardNormal.sample(&mut rng));
        let enough = share * squares(&draw);
        as_much += u32::from(all.iter().any(|possible| possible.explains(&draw) >= enough));
        if as_much >= most {
            return None;
        }
    }
    Some(f64::from(as_much + 1) / f64::from(DRAWS + 1))
}

fn change(all: &[Possible], best: &Possible, values: &[f64], chance: f64) -> Change {
    // Level, height and place are taken from the values.
    let dof = (values.len() - 3) as f64;
    let left = |possible: &Possible| (squares(values) - possible.explains(values)).max(0.0);
    let least = left(best);
    let u = (least / dof).sqrt() / best.norm;
    let bound = least * (1.0 + coverage::two_sided(WHEN, dof).powi(2) / dof);
    let may = all.iter().filter(|other| other.kind == best.kind && left(other) <= bound);
    let [mut before, mut after] = best.between();
    for [earlier, later] in may.map(Possible::between) {
        (before, after) = (before.min(earlier), after.max(later));
    }
    Change {
        kind: best.kind,
        by: best.along(values) / best.norm.powi(2),
        expanded: coverage::coverage_factor(dof) * u,
        first: best.first,
        between: [before, after],
        chance,
    }
}
