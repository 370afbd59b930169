//! Levenberg–Marquardt: the step is damped where the model differs too much from its linearisation.

use super::super::schur::{Factored, Rows, factor, held};
use super::{Model, Place, square_sum};

/// Initial value of λ.
const INITIAL_LAMBDA: f64 = 1e-3;
/// Fraction of the scale of an unknown that is kept from one iterate to the next.
const MEMORY: f64 = 0.7;
/// Step of the finite differences for the curvature, relative to the step (Transtrum and Sethna 2012).
const PROBE: f64 = 0.1;
/// Largest curvature correction, relative to the step.
const MAX_CURVATURE_RATIO: f64 = 0.75;
/// A step is accepted if χ² decreases by more than this fraction of the predicted decrease.
const MIN_GAIN_RATIO: f64 = 1e-4;
/// Largest λ. Beyond it the step is smaller than the rounding of the unknowns.
const LARGEST: f64 = 1e30;

/// λ and the scale of the unknowns to which it is relative (Marquardt 1963). The scale is the maximum of the
/// weighted column norms and decays by [`MEMORY`] (Moré 1978 keeps the maximum for ever), so that an unknown
/// does not diverge where its influence has become small.
pub(super) struct Damping {
    lambda: f64,
    /// Factor by which λ grows at the next failure (Nielsen 1999). It increases with each failure.
    growth: f64,
    scale: Vec<f64>,
}

impl Damping {
    pub(super) fn new() -> Self {
        Self { lambda: INITIAL_LAMBDA, growth: 2.0, scale: Vec::new() }
    }

    /// The next iterate with a smaller χ², or `None` if no step decreases χ². `tangent` is the model linearised at
    /// `at`.
    pub(super) fn descend<R: Fn(&[f64]) -> Vec<Rows>, S: Fn(&[f64]) -> Vec<f64>>(
        &mut self,
        model: &Model<R, S>,
        at: &Place,
        tangent: &Factored,
    ) -> Option<Place> {
        self.remember(&tangent.column_norms());
        let rows = (model.rows)(&at.x);
        while self.lambda <= LARGEST {
            let weights: Vec<f64> = self.scale.iter().map(|s| self.lambda.sqrt() * s).collect();
            let (held, coordinates) = factor(held(rows.clone(), &weights));
            let velocity = held.unknowns_at(&coordinates);
            if let Some(step) = self.bend(model, at, &held, &velocity) {
                let next = model.moved(at, &step);
                // Decrease of χ² predicted by the linearised model.
                let promise =
                    square_sum(&coordinates) + self.lambda * self.length(&velocity).powi(2);
                let gain = (at.chi2 - next.chi2) / promise;
                // The comparison rejects NaN.
                if gain > MIN_GAIN_RATIO {
                    self.relax(gain);
                    return Some(next);
                }
            }
            self.harden();
        }
        self.lambda = INITIAL_LAMBDA;
        None
    }

    fn remember(&mut self, norms: &[f64]) {
        self.scale.resize(norms.len(), 0.0);
        for (scale, norm) in self.scale.iter_mut().zip(norms) {
            *scale = norm.max(MEMORY * *scale);
            if *scale == 0.0 {
                *scale = 1.0;
            }
        }
    }

    /// The step plus half its geodesic acceleration (Transtrum and Sethna 2012): the second derivative of the model
    /// along the step, from two more evaluations. `None` if the curvature is too large.
    fn bend<R, S: Fn(&[f64]) -> Vec<f64>>(
        &self,
        model: &Model<R, S>,
        at: &Place,
        held: &Factored,
        velocity: &[f64],
    ) -> Option<Vec<f64>> {
        let probe = |by: f64| {
            let part: Vec<f64> = velocity.iter().map(|v| by * v).collect();
            model.moved(at, &part).residuals
        };
        let sides = probe(PROBE).into_iter().zip(probe(-PROBE)).zip(&at.residuals);
        let second: Vec<f64> =
            sides.map(|((ahead, behind), r)| (ahead - 2.0 * r + behind) / PROBE.powi(2)).collect();
        let bent = held.solve_damped(&second);
        let mild = 2.0 * self.length(&bent) <= MAX_CURVATURE_RATIO * self.length(velocity);
        mild.then(|| velocity.iter().zip(&bent).map(|(v, a)| v + 0.5 * a).collect())
    }

    fn length(&self, v: &[f64]) -> f64 {
        v.iter().zip(&self.scale).map(|(v, s)| (v * s).powi(2)).sum::<f64>().sqrt()
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
