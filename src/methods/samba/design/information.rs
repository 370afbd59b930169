//! Information about the machine from a choice of measurements: the inverse of its information matrix,
//! updated with each measurement. Balls without a certified length are eliminated.

use nalgebra::{Matrix3, Vector3};

use crate::samba::settings::Criterion;
use machine::Axis;

/// Initial variance of the unknowns in their units, so large that it contributes no information.
const UNKNOWN: f64 = 1e6;

/// A measurement of one ball at one indexation: ∂(tip on the table)/∂(machine errors, then tool), each column
/// in the unit of its unknown, divided by the standard uncertainty of a centre.
#[derive(Debug, Clone)]
pub struct CandidateMeasurement {
    pub indexation: usize,
    pub ball: usize,
    pub columns: Vec<Vector3<f64>>,
}

/// A certified distance: its balls, the direction from one to the other, and the inverse of its standard
/// uncertainty (in the unit of a ball coordinate).
#[derive(Debug, Clone, Copy)]
pub struct Bar {
    pub balls: [usize; 2],
    pub direction: Vector3<f64>,
    pub weight: f64,
}

/// Inverse of an information matrix, square, row by row.
#[derive(Debug, Clone)]
struct Inverse {
    size: usize,
    entries: Vec<f64>,
}

/// Terms of the update of an inverse P by three rows W: P·Wᵀ, and I + W·P·Wᵀ.
struct Effect {
    along: Vec<Vector3<f64>>,
    core: Matrix3<f64>,
}

impl Effect {
    /// (I + W·P·Wᵀ)⁻¹. It exists because P is positive definite.
    fn solved(&self) -> Matrix3<f64> {
        self.core.try_inverse().unwrap_or(Matrix3::repeat(f64::NAN))
    }
}

impl Inverse {
    fn new(size: usize) -> Self {
        let diagonal = |i: usize| if i.is_multiple_of(size + 1) { UNKNOWN } else { 0.0 };
        Self { size, entries: (0..size * size).map(diagonal).collect() }
    }

    /// `columns`: columns of W, one for each unknown.
    fn effect(&self, columns: &[Vector3<f64>]) -> Effect {
        let rows = self.entries.chunks_exact(self.size);
        let along: Vec<Vector3<f64>> =
            rows.map(|row| row.iter().zip(columns).map(|(p, w)| *w * *p).sum()).collect();
        let parts = columns.iter().zip(&along).map(|(w, pw)| w * pw.transpose());
        let core = Matrix3::identity() + parts.sum::<Matrix3<f64>>();
        Effect { along, core }
    }

    /// Adds the rows (Woodbury identity).
    fn join(&mut self, columns: &[Vector3<f64>]) {
        let effect = self.effect(columns);
        let (along, solved) = (&effect.along, effect.solved());
        for (row, left) in self.entries.chunks_exact_mut(self.size).zip(along) {
            let left = solved * left;
            row.iter_mut().zip(along).for_each(|(entry, right)| *entry -= left.dot(right));
        }
    }
}

/// Information about the machine's parameters, after elimination of tool and balls.
#[derive(Debug, Clone)]
pub struct Information {
    /// Number of machine parameters, which are the first unknowns.
    machine: usize,
    /// Index of the first coordinate of each ball among the unknowns; `None`: the ball is eliminated.
    slots: Vec<Option<usize>>,
    /// Number of measurements of each ball so far, and the mean of their columns.
    seen: Vec<(f64, Vec<Vector3<f64>>)>,
    full: Inverse,
    /// Inverse for tool and balls alone, with the machine known.
    rest: Inverse,
    /// Unit of a ball coordinate divided by the standard uncertainty of a centre.
    ball_unit: f64,
}

impl Information {
    /// `shared`: number of machine parameters and tool coordinates. Balls with a certified length remain
    /// among the unknowns.
    pub fn new(machine: usize, shared: usize, balls: usize, bars: &[Bar], ball_unit: f64) -> Self {
        let mut size = shared;
        let mut slots = vec![None; balls];
        for ball in bars.iter().flat_map(|bar| bar.balls) {
            if let Some(slot @ None) = slots.get_mut(ball) {
                *slot = Some(size);
                size += 3;
            }
        }
        let seen = vec![(0.0, vec![Vector3::zeros(); shared]); balls];
        let (full, rest) = (Inverse::new(size), Inverse::new(size - machine));
        let mut new = Self { machine, slots, seen, full, rest, ball_unit };
        bars.iter().for_each(|bar| new.join_bar(bar));
        new
    }

    fn join_bar(&mut self, bar: &Bar) {
        let mut columns = vec![Vector3::zeros(); self.full.size];
        for (ball, sign) in bar.balls.into_iter().zip([-1.0, 1.0]) {
            let Some(slot) = self.slots.get(ball).copied().flatten() else { continue };
            for (column, part) in columns.iter_mut().skip(slot).zip(&bar.direction) {
                *column = Vector3::new(sign * bar.weight * part, 0.0, 0.0);
            }
        }
        self.join(&columns);
    }

    fn join(&mut self, columns: &[Vector3<f64>]) {
        self.full.join(columns);
        self.rest.join(columns.get(self.machine..).unwrap_or_default());
    }

    /// The rows of the measurement for the unknowns. For an eliminated ball, the information about the ball
    /// itself is removed: n/(n+1) of the difference from the mean of the n earlier measurements remains.
    fn columns(&self, sight: &CandidateMeasurement) -> Vec<Vector3<f64>> {
        let slot = self.slots.get(sight.ball).copied().flatten();
        let mut columns = match (slot, self.seen.get(sight.ball)) {
            (None, Some((count, mean))) => {
                let share = (count / (count + 1.0)).sqrt();
                sight.columns.iter().zip(mean).map(|(new, mean)| (*new - *mean) * share).collect()
            }
            _ => sight.columns.clone(),
        };
        columns.resize(self.full.size, Vector3::zeros());
        if let Some(slot) = slot {
            let axes = Axis::LINEAR.map(|axis| -self.ball_unit * axis.direction());
            columns.iter_mut().skip(slot).zip(axes).for_each(|(column, to)| *column = to);
        }
        columns
    }

    /// Information gain of the measurement. D: increase of the logarithm of det(information); A: decrease of
    /// the sum of variances.
    pub fn gain(&self, sight: &CandidateMeasurement, criterion: Criterion) -> f64 {
        let columns = self.columns(sight);
        let full = self.full.effect(&columns);
        match criterion {
            Criterion::D => {
                let rest = self.rest.effect(columns.get(self.machine..).unwrap_or_default());
                full.core.determinant().ln() - rest.core.determinant().ln()
            }
            Criterion::A => {
                let solved = full.solved();
                full.along
                    .iter()
                    .take(self.machine)
                    .map(|along| along.dot(&(solved * *along)))
                    .sum()
            }
        }
    }

    /// Adds the measurement.
    pub fn add(&mut self, sight: &CandidateMeasurement) {
        let columns = self.columns(sight);
        self.join(&columns);
        if let Some((count, mean)) = self.seen.get_mut(sight.ball) {
            *count += 1.0;
            for (mean, new) in mean.iter_mut().zip(&sight.columns) {
                *mean += (*new - *mean) / *count;
            }
        }
    }
}
