//! Levenberg–Marquardt: the step is held back where the model does not keep what its tangent
//! promises.

use super::super::schur::{Factored, Rows, factor, held};
use super::{Model, Place, square_sum};

/// Where λ begins.
const FIRST: f64 = 1e-3;
/// What the scale of an unknown keeps from one place to the next.
const MEMORY: f64 = 0.7;
/// Length of the probes for the curvature, against the step (Transtrum and Sethna 2012).
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
    pub(super) fn new() -> Self {
        Self { lambda: FIRST, growth: 2.0, scale: Vec::new() }
    }

    /// The next place with a smaller χ²; `None` where nothing lessens it any more. `tangent` is the
    /// model linearised at the place.
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
                // By how much χ² would be less if the model were linear.
                let promise =
                    square_sum(&coordinates) + self.lambda * self.length(&velocity).powi(2);
                let gain = (at.chi2 - next.chi2) / promise;
                // Written so that a NaN is refused.
                if gain > KEPT {
                    self.relax(gain);
                    return Some(next);
                }
            }
            self.harden();
        }
        self.lambda = FIRST;
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

    /// The step with half its geodesic acceleration (Transtrum and Sethna 2012): the model's second
    /// derivative along it, from two more evaluations. `None` where the way bends too much.
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
        let bent = held.solve_held(&second);
        let mild = 2.0 * self.length(&bent) <= BENT * self.length(velocity);
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
