//! From radii to the unknowns: weighted least squares with the gauge made explicit, and the
//! second-order correction around it.

use faer::Mat;

use super::algebra::multiply;
use super::bend::Bend;
use super::model::{Layout, Observation};
use estimation::linear::{self, LinearError, LinearProblem, LinearSolution};

/// Relative threshold of rank decisions for paper 1 (METHODS, conventions).
pub const RANK_THRESHOLD: f64 = 1e-9;

/// The linear estimator for one set of observations, reusable for other radii at the same places.
pub struct Fit {
    pub layout: Layout,
    pub observations: Vec<Observation>,
    pub a: Mat<f64>,
    pub solution: LinearSolution,
    bend: Option<Bend>,
}

/// A solved set of radii.
pub struct Solved {
    pub x: Vec<f64>,
    /// Residuals of the corrected radii, mm.
    pub residuals: Vec<f64>,
}

impl Fit {
    /// # Errors
    /// The combinations of unknowns that these observations cannot tell apart.
    pub fn new(
        layout: Layout,
        observations: Vec<Observation>,
        sigma: &[f64],
        second_order: bool,
    ) -> Result<Self, LinearError> {
        let a = layout.matrix(&observations);
        let radii: Vec<f64> = observations.iter().map(|seen| seen.radius).collect();
        let gauge = layout.gauge();
        let solution = linear::solve(&LinearProblem {
            a: a.as_ref(),
            y: &radii,
            sigma,
            constraints: Some(gauge.as_ref()),
            rank_threshold: RANK_THRESHOLD,
        })?;
        let bend = second_order.then(|| Bend::new(&layout, &observations));
        Ok(Self { layout, observations, a, solution, bend })
    }

    /// Solve for other radii (one per observation).
    pub fn solve(&self, radii: &[f64]) -> Solved {
        let mut corrected = radii.to_vec();
        let mut x = multiply(&self.solution.gain, &corrected);
        if let Some(bend) = &self.bend {
            // The correction is some 20 um times the error of E over the radius: it contracts by
            // a factor of about 1e-3 a turn.
            for _ in 0..8 {
                corrected = radii.iter().zip(bend.terms(&x)).map(|(r, b)| r + b).collect();
                let next = multiply(&self.solution.gain, &corrected);
                let change = next.iter().zip(&x).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                x = next;
                if change < 1e-10 {
                    break;
                }
            }
        }
        let model = multiply(&self.a, &x);
        let residuals = corrected.iter().zip(&model).map(|(r, m)| r - m).collect();
        Solved { x, residuals }
    }

    /// Unknowns × observations: the derivative of the whole solution by each radius, second order
    /// included. With an eccentric part it differs from the linear gain by some W′/L, 2 % per mm.
    pub fn sensitivity(&self, radii: &[f64]) -> Mat<f64> {
        if self.bend.is_none() {
            return self.solution.gain.clone();
        }
        let step = 1e-3;
        let mut sensitivity = Mat::zeros(self.layout.unknowns(), radii.len());
        for j in 0..radii.len() {
            let moved = |by: f64| {
                let mut moved = radii.to_vec();
                moved[j] += by;
                self.solve(&moved).x
            };
            let (up, down) = (moved(step), moved(-step));
            for (i, (u, d)) in up.iter().zip(&down).enumerate() {
                sensitivity[(i, j)] = (u - d) / (2.0 * step);
            }
        }
        sensitivity
    }
}
