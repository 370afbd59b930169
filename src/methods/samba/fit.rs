//! All measurements as one least-squares problem. Machine and stylus are common to all rows; the balls are
//! its blocks. Balls with a certified length between them share a block.

mod measurement;

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::model::{Affine, Indexed, Model};
use estimation::nonlinear::{Minimum, NonlinearError, minimise};
use estimation::schur::Rows;
use machine::Position;
use machine::frame::unit_vector;

pub use measurement::Measurement;

/// One measurement of a ball: position and weight.
#[derive(Debug, Clone, Copy)]
pub struct Seen {
    /// Index of the rotary position.
    pub place: usize,
    pub ball: usize,
    /// Whitening matrix W with W·Σ·Wᵀ = I, where Σ is the covariance of the measured centre, machine frame,
    /// mm².
    pub whitening: Matrix3<f64>,
}

/// A certified length between two balls.
#[derive(Debug, Clone, Copy)]
pub struct Bar {
    pub from: usize,
    pub to: usize,
    pub u_mm: f64,
}

/// Observed values, mm: the ball centres as axis positions, and the certified lengths.
#[derive(Debug, Clone)]
pub struct Measured {
    pub xyz: Vec<Vector3<f64>>,
    pub lengths: Vec<f64>,
}

#[derive(Debug, Clone)]
pub struct Problem {
    model: Model,
    stylus: Vector3<f64>,
    places: Vec<Position>,
    seen: Vec<Seen>,
    bars: Vec<Bar>,
    groups: Vec<Group>,
    /// Index of the first coordinate of each ball among the unknowns.
    ball_at: Vec<usize>,
    /// Matrix of each measurement from the table frame to weighted residuals.
    weights: Vec<Matrix3<f64>>,
    /// Index of the first row of each measurement, then of each length.
    row_at: Vec<usize>,
}

/// Balls that share a block, with their measurements and lengths.
#[derive(Debug, Clone, Default)]
struct Group {
    balls: Vec<usize>,
    seen: Vec<usize>,
    bars: Vec<usize>,
}

impl Problem {
    /// Each of the `balls` must have a measurement. `stylus` is the stated one; coordinates that are not free
    /// keep their value.
    pub fn new(
        model: Model,
        places: Vec<Position>,
        seen: Vec<Seen>,
        bars: Vec<Bar>,
        balls: usize,
        stylus: Vector3<f64>,
    ) -> Self {
        let groups = groups(&seen, &bars, balls);
        let common = model.parameters().len() + model.stylus().len();
        let (mut ball_at, mut next) = (vec![0; balls], common);
        for ball in groups.iter().flat_map(|group| &group.balls) {
            ball_at[*ball] = next;
            next += 3;
        }
        let (mut row_at, mut row) = (vec![0; seen.len() + bars.len()], 0);
        for group in &groups {
            for sight in &group.seen {
                row_at[*sight] = row;
                row += 3;
            }
            for bar in &group.bars {
                row_at[seen.len() + bar] = row;
                row += 1;
            }
        }
        let zero = vec![0.0; model.parameters().len()];
        let into_machine: Vec<Matrix3<f64>> = places
            .iter()
            .map(|place| model.tips(place, &zero, Vector3::zeros()).inverse())
            .collect();
        let weights = seen.iter().map(|s| s.whitening * into_machine[s.place]).collect();
        Self { model, stylus, places, seen, bars, groups, ball_at, weights, row_at }
    }

    pub fn model(&self) -> &Model {
        &self.model
    }

    /// The same measurements with other unknown machine errors.
    #[cfg(test)]
    pub fn with_model(self, model: Model) -> Self {
        Self::new(model, self.places, self.seen, self.bars, self.ball_at.len(), self.stylus)
    }

    pub fn unknowns(&self) -> usize {
        self.common() + 3 * self.ball_at.len()
    }

    pub fn rows_count(&self) -> usize {
        3 * self.seen.len() + self.bars.len()
    }

    /// Index of the ball's first coordinate among the unknowns: machine, tool, balls.
    pub fn ball_at(&self, ball: usize) -> usize {
        self.ball_at[ball]
    }

    /// Index of the first of the three rows of a measurement.
    pub fn row_of(&self, seen: usize) -> usize {
        self.row_at[seen]
    }

    pub fn row_of_bar(&self, bar: usize) -> usize {
        self.row_at[self.seen.len() + bar]
    }

    /// Matrix from the table frame to the weighted residuals of a measurement.
    pub fn weight(&self, seen: usize) -> Matrix3<f64> {
        self.weights[seen]
    }

    fn common(&self) -> usize {
        self.model.parameters().len() + self.model.stylus().len()
    }

    /// Errors and stylus from the unknowns `x`.
    fn machine<'x>(&self, x: &'x [f64]) -> (&'x [f64], Vector3<f64>) {
        let (errors, rest) = x.split_at(self.model.parameters().len());
        let mut stylus = self.stylus;
        for (k, value) in self.model.stylus().iter().zip(rest) {
            stylus[*k] = *value;
        }
        (errors, stylus)
    }

    /// Start values: zero errors, the stated stylus, and the balls at their mean positions from the nominal
    /// machine.
    pub fn start(&self, measured: &Measured) -> Vec<f64> {
        let mut x = vec![0.0; self.unknowns()];
        let first = self.model.parameters().len();
        for (i, k) in self.model.stylus().iter().enumerate() {
            x[first + i] = self.stylus[*k];
        }
        let mut counts = vec![0.0; self.ball_at.len()];
        for (seen, tip) in self.seen.iter().zip(self.tips(&x, measured)) {
            counts[seen.ball] += 1.0;
            let at = self.ball_at[seen.ball];
            let mean = vector(&x, at) + (tip - vector(&x, at)) / counts[seen.ball];
            put(&mut x, at, mean);
        }
        x
    }

    /// The unknowns that minimise the weighted sum of squares.
    ///
    /// # Errors
    /// The measurements do not separate the unknowns; the iteration does not converge.
    pub fn solve(&self, measured: &Measured, start: Vec<f64>) -> Result<Minimum, NonlinearError> {
        minimise(start, |x| self.rows(x, measured), |x| self.residuals(x, measured))
    }

    /// Position of the ball in each measurement from the machine with these errors, table frame, mm.
    pub fn tips(&self, x: &[f64], measured: &Measured) -> Vec<Vector3<f64>> {
        let (errors, tool) = self.machine(x);
        let at: Vec<_> =
            self.places.iter().map(|place| self.model.tips(place, errors, tool)).collect();
        self.seen.iter().zip(&measured.xyz).map(|(seen, xyz)| at[seen.place].at(*xyz)).collect()
    }

    /// For each rotary position, the matrix from a motion of X, Y, Z to the motion of the stylus relative to
    /// the workpiece with these errors, in the directions of the nominal axes.
    pub fn ways(&self, x: &[f64]) -> Vec<Matrix3<f64>> {
        let (errors, tool) = self.machine(x);
        let zero = vec![0.0; errors.len()];
        let ways = self.places.iter().map(|place| {
            self.model.tips(place, &zero, tool).inverse()
                * self.model.tips(place, errors, tool).linear()
        });
        ways.collect()
    }

    /// Weighted residuals, measured minus model, in the order of the rows.
    pub fn residuals(&self, x: &[f64], measured: &Measured) -> Vec<f64> {
        let mut residuals = vec![0.0; self.rows_count()];
        for (i, tip) in self.tips(x, measured).into_iter().enumerate() {
            let ball = vector(x, self.ball_at[self.seen[i].ball]);
            put(&mut residuals, self.row_at[i], self.weights[i] * (ball - tip));
        }
        for (i, bar) in self.bars.iter().enumerate() {
            let apart = self.apart(x, bar).norm();
            residuals[self.row_of_bar(i)] = (measured.lengths[i] - apart) / bar.u_mm;
        }
        residuals
    }

    fn apart(&self, x: &[f64], bar: &Bar) -> Vector3<f64> {
        vector(x, self.ball_at[bar.to]) - vector(x, self.ball_at[bar.from])
    }

    /// The model linearised at `x`, group by group.
    pub fn rows(&self, x: &[f64], measured: &Measured) -> Vec<Rows> {
        let (errors, tool) = self.machine(x);
        let at: Vec<Indexed> =
            self.places.par_iter().map(|place| self.model.indexed(place, errors, tool)).collect();
        let group_rows = |group: &Group| {
            let count = 3 * group.seen.len() + group.bars.len();
            let mut rows = Rows::zeros(count, 3 * group.balls.len(), self.common());
            let first = self.ball_at[group.balls[0]];
            for (n, i) in group.seen.iter().enumerate() {
                let indexed = &at[self.seen[*i].place];
                self.ball_rows(&mut rows, 3 * n, first, *i, indexed, x, measured.xyz[*i]);
            }
            for (n, i) in group.bars.iter().enumerate() {
                let row = 3 * group.seen.len() + n;
                self.bar_row(&mut rows, row, first, &self.bars[*i], x, measured.lengths[*i]);
            }
            rows
        };
        self.groups.iter().map(group_rows).collect()
    }

    /// Fills the three rows of the measurement `i`, starting at `row`; the unknowns of the block start at
    /// `first`.
    #[allow(clippy::too_many_arguments)]
    fn ball_rows(
        &self,
        rows: &mut Rows,
        row: usize,
        first: usize,
        i: usize,
        indexed: &Indexed,
        x: &[f64],
        xyz: Vector3<f64>,
    ) {
        let (weight, ball_at) = (self.weights[i], self.ball_at[self.seen[i].ball]);
        let value = weight * (vector(x, ball_at) - indexed.tip(xyz));
        (0..3).for_each(|k| rows.set_value(row + k, value[k]));
        let mut set = |j: usize, column: Vector3<f64>| {
            let weighted = weight * column;
            (0..3).for_each(|k| rows.set_common(row + k, j, weighted[k]));
        };
        let errors = self.model.parameters().len();
        (0..errors).for_each(|j| set(j, indexed.machine(j, xyz)));
        for (j, coordinate) in self.model.stylus().iter().enumerate() {
            set(errors + j, indexed.tool.column(*coordinate).into_owned());
        }
        for j in 0..3 {
            let column = -weight.column(j);
            (0..3).for_each(|k| rows.set_own(row + k, ball_at - first + j, column[k]));
        }
    }

    fn bar_row(
        &self,
        rows: &mut Rows,
        row: usize,
        first: usize,
        bar: &Bar,
        x: &[f64],
        length: f64,
    ) {
        let apart = self.apart(x, bar);
        let along = unit_vector(apart).unwrap_or_default() / bar.u_mm;
        rows.set_value(row, (length - apart.norm()) / bar.u_mm);
        for j in 0..3 {
            rows.set_own(row, self.ball_at[bar.to] - first + j, along[j]);
            rows.set_own(row, self.ball_at[bar.from] - first + j, -along[j]);
        }
    }

    /// Measurements of an exact machine with these unknowns. Only rows linearised there show the true null
    /// space: with nonzero residuals a uniform shrinking would reduce them and appear determined.
    pub fn ideal(&self, x: &[f64]) -> Measured {
        let (errors, tool) = self.machine(x);
        let at: Vec<Affine> =
            self.places.iter().map(|place| self.model.tips(place, errors, tool)).collect();
        let xyz = self.seen.iter().map(|seen| {
            let tip = &at[seen.place];
            let ball = vector(x, self.ball_at[seen.ball]);
            tip.inverse() * (ball - tip.at(Vector3::zeros()))
        });
        let lengths = self.bars.iter().map(|bar| self.apart(x, bar).norm());
        Measured { xyz: xyz.collect(), lengths: lengths.collect() }
    }
}

/// Groups of balls joined by lengths, in the order of the first ball of each group.
fn groups(seen: &[Seen], bars: &[Bar], balls: usize) -> Vec<Group> {
    let mut of: Vec<usize> = (0..balls).collect();
    for bar in bars {
        let (kept, joined) = (of[bar.from].min(of[bar.to]), of[bar.from].max(of[bar.to]));
        of.iter_mut().filter(|group| **group == joined).for_each(|group| *group = kept);
    }
    let mut groups = vec![Group::default(); balls];
    (0..balls).for_each(|ball| groups[of[ball]].balls.push(ball));
    seen.iter().enumerate().for_each(|(i, seen)| groups[of[seen.ball]].seen.push(i));
    bars.iter().enumerate().for_each(|(i, bar)| groups[of[bar.from]].bars.push(i));
    groups.retain(|group| !group.balls.is_empty());
    groups
}

pub fn vector(x: &[f64], at: usize) -> Vector3<f64> {
    Vector3::new(x[at], x[at + 1], x[at + 2])
}

fn put(x: &mut [f64], at: usize, value: Vector3<f64>) {
    x[at..at + 3].copy_from_slice(value.as_slice());
}
