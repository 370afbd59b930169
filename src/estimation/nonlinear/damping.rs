//! Levenberg–Marquardt: the step is held back where the model does not keep what its tangent
//! promises.

use faer::Mat;

use super::super::linear::{LinearError, LinearProblem, LinearSolution, solve};
use super::{Linearised, Place, Problem, chi2, moved, product};

/// What the scale of an unknown keeps from one place to the next.
const MEMORY: f64 = 0.7;
/// Length of the probe for the curvature, against the step (Transtrum and Sethna 2012).
const PROBE: f64 = 0.1;
/// A correction by the curvature may be this large against the step.
const BENT: f64 = 0.75;
/// A step must take away this part of what it promises.
const KEPT: f64 = 1e-4;
/// Beyond it a step is lost in the rounding of the unknowns.
const LARGEST: f64 = 1e30;

/// λ and the scale of the unknowns, which it stands on (Marquardt 1963): the weighted column norm,
/// as a maximum that forgets (Moré 1978 keeps it for ever), so that an unknown that mattered does
/// not run away where it matters no more.
pub(super) struct Damping {
    lambda: f64,
    /// By which λ grows at the next failure (Nielsen 1999): faster each time.
    growth: f64,
    scale: Vec<f64>,
}

impl Damping {
    pub(super) fn new(lambda: f64) -> Self {
        Self { lambda, growth: 2.0, scale: Vec::new() }
    }

    /// The next place with a smaller χ²; `None` where nothing lessens it any more, or after
    /// `max_evaluations`.
    pub(super) fn descend<M: FnMut(&[f64]) -> Linearised>(
        &mut self,
        problem: &mut Problem<'_, M>,
        at: &Place,
        max_evaluations: usize,
    ) -> Result<Option<Place>, LinearError> {
        self.remember(&at.point.jacobian, problem.sigma);
        while self.lambda <= LARGEST && problem.evaluations < max_evaluations {
            let velocity = self.velocity(problem, at)?;
            let Some(step) = self.bend(problem, at, &velocity) else {
                self.harden();
                continue;
            };
            let next = problem.place(moved(&at.x, &step));
            let gain = (at.chi2 - next.chi2) / self.promise(problem, at, &velocity.x);
            // Written so that a NaN is refused.
            if gain > KEPT {
                self.relax(gain);
                return Ok(Some(next));
            }
            self.harden();
        }
        Ok(None)
    }

    fn remember(&mut self, jacobian: &Mat<f64>, sigma: &[f64]) {
        self.scale.resize(jacobian.ncols(), 0.0);
        for (j, scale) in self.scale.iter_mut().enumerate() {
            let squares = sigma.iter().enumerate().map(|(i, s)| (jacobian[(i, j)] / s).powi(2));
            *scale = squares.sum::<f64>().sqrt().max(MEMORY * *scale);
            if *scale == 0.0 {
                *scale = 1.0;
            }
        }
    }

    /// The damped step: rows of √λ·scale stand below, with the value 0.
    fn velocity<M>(
        &self,
        problem: &Problem<'_, M>,
        at: &Place,
    ) -> Result<LinearSolution, LinearError> {
        let Linearised { residuals, jacobian } = &at.point;
        let (rows, unknowns) = (jacobian.nrows(), jacobian.ncols());
        let a = Mat::from_fn(rows + unknowns, unknowns, |i, j| match i {
            i if i < rows => jacobian[(i, j)],
            i if i - rows == j => self.lambda.sqrt() * self.scale[j],
            _ => 0.0,
        });
        let extended = |values: &[f64], by: f64| -> Vec<f64> {
            values.iter().copied().chain(std::iter::repeat_n(by, unknowns)).collect()
        };
        solve(&LinearProblem {
            a: a.as_ref(),
            y: &extended(residuals, 0.0),
            sigma: &extended(problem.sigma, 1.0),
            constraints: problem.constraints,
            rank_threshold: 0.0,
        })
    }

    /// The step with half its geodesic acceleration (Transtrum and Sethna 2012): the model's second
    /// derivative along it, from one more evaluation. `None` where the way bends too much.
    fn bend<M: FnMut(&[f64]) -> Linearised>(
        &self,
        problem: &mut Problem<'_, M>,
        at: &Place,
        velocity: &LinearSolution,
    ) -> Option<Vec<f64>> {
        let part: Vec<f64> = velocity.x.iter().map(|dx| PROBE * dx).collect();
        let probe = problem.place(moved(&at.x, &part)).point.residuals;
        let along = product(&at.point.jacobian, &velocity.x);
        let curvature = (0..probe.len())
            .map(|i| 2.0 / PROBE * ((at.point.residuals[i] - probe[i]) / PROBE - along[i]));
        let mut bent = vec![0.0; velocity.x.len()];
        for (i, second) in curvature.enumerate() {
            for (j, bent) in bent.iter_mut().enumerate() {
                *bent -= velocity.gain[(j, i)] * second;
            }
        }
        let length =
            |v: &[f64]| v.iter().zip(&self.scale).map(|(v, s)| (v * s).powi(2)).sum::<f64>();
        let mild = 2.0 * length(&bent).sqrt() <= BENT * length(&velocity.x).sqrt();
        mild.then(|| velocity.x.iter().zip(&bent).map(|(v, a)| v + 0.5 * a).collect())
    }

    /// By how much the damped step would lessen χ² if the model were linear.
    fn promise<M>(&self, problem: &Problem<'_, M>, at: &Place, step: &[f64]) -> f64 {
        let along = product(&at.point.jacobian, step);
        let seen = chi2(&along, problem.sigma);
        let held: f64 = step.iter().zip(&self.scale).map(|(dx, s)| (dx * s).powi(2)).sum();
        seen + 2.0 * self.lambda * held
    }

    fn relax(&mut self, gain: f64) {
        self.lambda *= (1.0 - (2.0 * gain - 1.0).powi(3)).max(1.0 / 3.0);
        self.growth = 2.0;
    }

    fn harden(&mut self) {
        self.lambda *= self.growth;
        self.growth *= 2.0;
    }
}
