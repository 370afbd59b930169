//! The second-order terms of the measurement equation (METHODS section 1): what a radius lacks
//! because the ball meets the part beside the ray. The coefficients do not depend on the unknowns; many
//! trials are evaluated at once.

use faer::{Mat, MatRef};
use nalgebra::Vector3;

use super::model::{Layout, Observation};
use super::outputs::scale_and_squareness;
use estimation::trigonometric::Trigonometric;

pub struct Bend {
    pub contacts: Vec<Contact>,
    pub heights: Vec<HeightForms>,
}

/// One observation.
pub struct Contact {
    pub height: usize,
    pub normal: Vector3<f64>,
    /// Indices of its unknowns.
    pub ex: usize,
    pub ey: usize,
    /// Grid angle on the part.
    pub theta: usize,
    pub lateral: f64,
}

/// Linear forms over the unknowns at one height.
pub struct HeightForms {
    /// Index of R.
    pub radius: usize,
    /// Unknowns × forms: at each grid angle the derivative of W, 1/rad; then scale difference and
    /// squareness for R = 1 mm.
    pub forms: Mat<f64>,
}

impl Bend {
    pub fn new(layout: &Layout, observations: &[Observation]) -> Self {
        let contacts = observations.iter().map(|seen| Contact::new(layout, seen)).collect();
        let heights = (0..layout.heights).map(|height| HeightForms::new(layout, height)).collect();
        Self { contacts, heights }
    }

    /// τW′/L + τ²/2L, τ = (E − E_lin)·t − lateral, L = R, mm: trials × observations, at the unknowns `x`
    /// (trials × unknowns).
    pub fn terms(&self, x: &Mat<f64>) -> Mat<f64> {
        let forms: Vec<Mat<f64>> =
            self.heights.iter().map(|height| multiply_trials(x, height.forms.as_ref())).collect();
        Mat::from_fn(x.nrows(), self.contacts.len(), |trial, i| {
            let Contact { height, normal, ex, ey, theta, lateral } = self.contacts[i];
            let (cos, sin) = (normal.x, normal.y);
            let form = |j: usize| forms[height][(trial, j)];
            let scale = forms[height].ncols() - 2;
            // E_lin·t. The forms hold 1/L, the deviations L: they cancel.
            let linear_axes = form(scale + 1) * sin * sin + form(scale) * sin * cos;
            let tau = -x[(trial, ex)] * sin + x[(trial, ey)] * cos - linear_axes - lateral;
            tau * (form(theta) + tau / 2.0) / x[(trial, self.heights[height].radius)]
        })
    }
}

impl Contact {
    fn new(layout: &Layout, seen: &Observation) -> Self {
        Self {
            height: seen.height,
            normal: layout.normal(seen.phi),
            ex: layout.ex(seen.height, seen.c),
            ey: layout.ey(seen.height, seen.c),
            theta: layout.design.theta(seen.c, seen.phi),
            lateral: seen.lateral,
        }
    }
}

impl HeightForms {
    fn new(layout: &Layout, height: usize) -> Self {
        let n = layout.design.n;
        let mut forms = Mat::zeros(layout.unknowns(), n + 2);
        for j in 0..n {
            let mut unit = vec![0.0; n];
            unit[j] = 1.0;
            let interpolant = Trigonometric::new(&unit);
            for i in 0..n {
                forms[(layout.w(height, j), i)] = interpolant.derivative(layout.design.angle(i));
            }
        }
        let (scale_difference, squareness) = scale_and_squareness(layout, height, 1.0);
        forms.col_as_slice_mut(n).copy_from_slice(&scale_difference);
        forms.col_as_slice_mut(n + 1).copy_from_slice(&squareness);
        Self { radius: layout.radius(height), forms }
    }
}

/// `trials` (trials × n) times `matrix` (n × columns), summed in the order of n: the rounding of a trial
/// does not depend on the number of trials. The numerical derivative of the fit amplifies rounding.
pub fn multiply_trials(trials: &Mat<f64>, matrix: MatRef<'_, f64>) -> Mat<f64> {
    let mut product = Mat::zeros(trials.nrows(), matrix.ncols());
    for j in 0..matrix.ncols() {
        for (k, factor) in matrix.col(j).iter().enumerate().filter(|(_, factor)| **factor != 0.0) {
            let sums = product.col_as_slice_mut(j).iter_mut();
            sums.zip(trials.col_as_slice(k)).for_each(|(sum, value)| *sum += factor * value);
        }
    }
    product
}
