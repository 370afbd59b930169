//! From radii to the unknowns: weighted least squares with the gauge made explicit, and the
//! second-order correction around it.

use faer::Mat;

use super::model::{Layout, Observation};
use crate::estimation::linear::{self, LinearError, LinearProblem, LinearSolution};
use crate::estimation::trigonometric::Trigonometric;

/// Relative threshold of rank decisions for paper 1 (METHODS, conventions).
pub const RANK_THRESHOLD: f64 = 1e-9;

/// The linear estimator for one set of observations, reusable for other radii at the same places.
pub struct Fit {
    pub layout: Layout,
    pub observations: Vec<Observation>,
    pub a: Mat<f64>,
    pub solution: LinearSolution,
    pub second_order: bool,
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
        Ok(Self { layout, observations, a, solution, second_order })
    }

    /// Solve for other radii (one per observation).
    pub fn solve(&self, radii: &[f64]) -> Solved {
        let mut corrected = radii.to_vec();
        let mut x = multiply(&self.solution.gain, &corrected);
        if self.second_order {
            // The correction is some 20 um times the error of E over the radius: it contracts by
            // a factor of about 1e-3 a turn.
            for _ in 0..8 {
                let bend = self.second_order_terms(&x);
                corrected = radii.iter().zip(&bend).map(|(r, b)| r + b).collect();
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

    /// τW′/L + τ²/2L for every observation: what the radius lacks because the ball meets the part
    /// beside the ray by τ = (E − E_lin)·t − lateral (METHODS section 1, second order).
    fn second_order_terms(&self, x: &[f64]) -> Vec<f64> {
        let layout = &self.layout;
        let design = &layout.design;
        let heights: Vec<HeightTerms> =
            (0..layout.heights).map(|height| HeightTerms::new(layout, height, x)).collect();
        self.observations
            .iter()
            .map(|seen| {
                let terms = &heights[seen.height];
                let (sin, cos) = design.angle(seen.phi).sin_cos();
                let ex = x[layout.ex(seen.height, seen.c)];
                let ey = x[layout.ey(seen.height, seen.c)];
                let tau = -ex * sin + ey * cos - terms.linear_axes(sin, cos) - seen.lateral;
                let slope = terms.slope[design.theta(seen.c, seen.phi)];
                tau * slope / terms.radius + tau * tau / (2.0 * terms.radius)
            })
            .collect()
    }
}

/// What the second-order terms need to know of one height.
struct HeightTerms {
    radius: f64,
    /// W′ at the grid angles, mm/rad.
    slope: Vec<f64>,
    scale_difference: f64,
    squareness: f64,
}

impl HeightTerms {
    fn new(layout: &Layout, height: usize, x: &[f64]) -> Self {
        let n = layout.design.n;
        let flank: Vec<f64> = (0..n).map(|i| x[layout.w(height, i)]).collect();
        let interpolant = Trigonometric::new(&flank);
        let slope = (0..n).map(|i| interpolant.derivative(layout.design.angle(i))).collect();
        let radius = x[layout.radius(height)];
        let (scale, square) = scale_and_squareness(layout, height, radius);
        Self { radius, slope, scale_difference: dot(&scale, x), squareness: dot(&square, x) }
    }

    /// E_lin·t from the scale difference and the squareness, mm.
    fn linear_axes(&self, sin: f64, cos: f64) -> f64 {
        self.radius * (self.squareness * sin * sin + self.scale_difference * sin * cos)
    }
}

/// Coefficients over the unknowns of E_YY1 − E_XX1 and of E_C0Y, from the second harmonic of E_r:
/// with E_lin = (−E_C0Y·y, (E_YY1 − E_XX1)·y), E_r = L(d·sin²φ − E_C0Y·sinφ·cosφ).
pub fn scale_and_squareness(layout: &Layout, height: usize, radius: f64) -> (Vec<f64>, Vec<f64>) {
    let n = layout.design.n;
    let mut scale = vec![0.0; layout.unknowns()];
    let mut square = vec![0.0; layout.unknowns()];
    for i in 0..n {
        let (sin, cos) = (2.0 * layout.design.angle(i)).sin_cos();
        let weight = -4.0 / (n as f64 * radius);
        scale[layout.er(height, i)] = weight * cos;
        square[layout.er(height, i)] = weight * sin;
    }
    (scale, square)
}

pub fn dot(coefficients: &[f64], x: &[f64]) -> f64 {
    coefficients.iter().zip(x).map(|(c, v)| c * v).sum()
}

pub fn multiply(matrix: &Mat<f64>, vector: &[f64]) -> Vec<f64> {
    let mut product = vec![0.0; matrix.nrows()];
    for (j, value) in vector.iter().enumerate() {
        for (out, m) in product.iter_mut().zip(matrix.col(j).iter()) {
            *out += m * value;
        }
    }
    product
}
