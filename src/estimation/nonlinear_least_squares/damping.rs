//! Levenberg–Marquardt: the step is damped where the model differs too much from its linearisation.

use super::super::schur::{BlockFactorisation, BlockRows, add_damping_rows, factorise_and_project_right_side};
use super::{LeastSquaresModel, ModelPoint, square_sum};

/// Value of λ at the start, and after no step has decreased χ².
const INITIAL_LAMBDA: f64 = 1e-3;
/// Fraction of the scale of an unknown that is kept from one iterate to the next.
const SCALE_DECAY: f64 = 0.7;
/// Step of the finite differences for the curvature, relative to the step (Transtrum and Sethna 2012).
const CURVATURE_STEP_FRACTION: f64 = 0.1;
/// Largest geodesic acceleration: twice its scaled norm, relative to that of the step. A step with a larger
/// acceleration is rejected.
const MAX_ACCELERATION_RATIO: f64 = 0.75;
/// A damped step is accepted if χ² decreases by more than this fraction of the predicted decrease.
const MIN_DAMPED_DECREASE_RATIO: f64 = 1e-4;
/// Largest λ. With a larger λ the step is smaller than the rounding of the unknowns.
const MAX_LAMBDA: f64 = 1e30;

/// λ and the scale of each unknown, to which λ is relative (Marquardt 1963). The scale is the maximum of the
/// weighted column norms and decays by [`SCALE_DECAY`] (Moré 1978: without decay), so that an unknown does not diverge
/// where its influence has become small.
pub(super) struct Damping {
    lambda: f64,
    /// Factor by which λ grows at the next rejected step (Nielsen 1999). The factor doubles with each rejected step.
    lambda_growth: f64,
    /// Scale of each unknown; the damping row of an unknown is √λ times its scale.
    unknown_scales: Vec<f64>,
}

impl Damping {
    pub(super) fn new() -> Self {
        Self { lambda: INITIAL_LAMBDA, lambda_growth: 2.0, unknown_scales: Vec::new() }
    }

    /// The next iterate with a smaller χ², or `None` if no step decreases χ². `tangent` is the model linearised at
    /// `point`.
    pub(super) fn damped_step<R: Fn(&[f64]) -> Vec<BlockRows>, S: Fn(&[f64]) -> Vec<f64>>(
        &mut self,
        model: &LeastSquaresModel<R, S>,
        point: &ModelPoint,
        tangent: &BlockFactorisation,
    ) -> Option<ModelPoint> {
        self.update_unknown_scales(&tangent.column_norms());
        let rows = (model.rows_at)(&point.x);
        while self.lambda <= MAX_LAMBDA {
            let weights: Vec<f64> = self.unknown_scales.iter().map(|s| self.lambda.sqrt() * s).collect();
            let (damped, coordinates) = factorise_and_project_right_side(add_damping_rows(rows.clone(), &weights));
            let velocity = damped.unknowns_from_coordinates(&coordinates);
            if let Some(step) = self.accelerated_step(model, point, &damped, &velocity) {
                let next = model.evaluate_after_step(point, &step);
                // Decrease of χ² predicted by the linearised model.
                let predicted_decrease = square_sum(&coordinates) + self.lambda * self.scaled_norm(&velocity).powi(2);
                let gain = (point.residual_square_sum - next.residual_square_sum) / predicted_decrease;
                // The comparison rejects NaN.
                if gain > MIN_DAMPED_DECREASE_RATIO {
                    self.decrease_lambda(gain);
                    return Some(next);
                }
            }
            self.increase_lambda();
        }
        self.lambda = INITIAL_LAMBDA;
        None
    }

    /// Sets each scale to its column norm, or to the decayed old scale if that is greater; 1 if both are 0.
    fn update_unknown_scales(&mut self, column_norms: &[f64]) {
        self.unknown_scales.resize(column_norms.len(), 0.0);
        for (scale, norm) in self.unknown_scales.iter_mut().zip(column_norms) {
            *scale = norm.max(SCALE_DECAY * *scale);
            if *scale == 0.0 {
                *scale = 1.0;
            }
        }
    }

    /// The step plus half its geodesic acceleration (Transtrum and Sethna 2012): the second derivative of the model
    /// along the step, from two more evaluations. `None` if the curvature is too large.
    fn accelerated_step<R, S: Fn(&[f64]) -> Vec<f64>>(
        &self,
        model: &LeastSquaresModel<R, S>,
        point: &ModelPoint,
        damped: &BlockFactorisation,
        velocity: &[f64],
    ) -> Option<Vec<f64>> {
        let probe = |by: f64| {
            let part: Vec<f64> = velocity.iter().map(|v| by * v).collect();
            model.evaluate_after_step(point, &part).residuals
        };
        let sides =
            probe(CURVATURE_STEP_FRACTION).into_iter().zip(probe(-CURVATURE_STEP_FRACTION)).zip(&point.residuals);
        let second: Vec<f64> =
            sides.map(|((ahead, behind), r)| (ahead - 2.0 * r + behind) / CURVATURE_STEP_FRACTION.powi(2)).collect();
        let acceleration = damped.solve_damped(&second);
        let mild = 2.0 * self.scaled_norm(&acceleration) <= MAX_ACCELERATION_RATIO * self.scaled_norm(velocity);
        mild.then(|| velocity.iter().zip(&acceleration).map(|(v, a)| v + 0.5 * a).collect())
    }

    /// Norm of `v` after each entry is multiplied by the scale of its unknown.
    fn scaled_norm(&self, v: &[f64]) -> f64 {
        v.iter().zip(&self.unknown_scales).map(|(v, s)| (v * s).powi(2)).sum::<f64>().sqrt()
    }

    /// `decrease_ratio`: decrease of χ² by the step, divided by the predicted decrease.
    fn decrease_lambda(&mut self, decrease_ratio: f64) {
        self.lambda *= (1.0 - (2.0 * decrease_ratio - 1.0).powi(3)).max(1.0 / 3.0);
        self.lambda_growth = 2.0;
    }

    fn increase_lambda(&mut self) {
        self.lambda *= self.lambda_growth;
        self.lambda_growth *= 2.0;
    }
}
