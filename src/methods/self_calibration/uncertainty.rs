//! Propagation of the sources through the identification: by covariance and by Monte Carlo
//! (JCGM 100 and JCGM 101; METHODS section 6).

use faer::Mat;
use rand::Rng;

use super::algebra::multiply;
use super::sources::{UncertaintySource, is_touch_by_touch};
use estimation::coverage;

/// First-order propagation to linear outputs (outputs × unknowns coefficients).
pub struct Propagated {
    /// Outputs × outputs.
    pub covariance: Mat<f64>,
    /// Per source: standard uncertainty of each output.
    pub budget: Vec<(&'static str, Vec<f64>)>,
    /// Per output: variance from the sources that the residuals show.
    pub touch_variance: Vec<f64>,
}

/// How the touches' own scatter was judged.
#[derive(Debug, Clone, Copy)]
pub struct TouchScale {
    /// Factor on the declared (or assumed) standard uncertainty of a touch.
    pub factor: f64,
    /// Degrees of freedom behind the factor; `None` where the declared value stands.
    pub dof: Option<f64>,
}

impl TouchScale {
    /// Declared repeatability stands unless the residuals contradict it (χ² above its 99.9 %
    /// bound); without a declaration the residuals judge.
    pub fn judge(declared: bool, chi2: f64, dof: usize) -> Self {
        let nu = dof as f64;
        let bounds = coverage::chi_square_bounds(nu, 0.998);
        let contradicted = bounds.is_some_and(|(_, upper)| chi2 > upper);
        if dof == 0 || (declared && !contradicted) {
            Self { factor: 1.0, dof: None }
        } else {
            Self { factor: (chi2 / nu).sqrt(), dof: Some(nu) }
        }
    }
}

impl Propagated {
    /// `sensitivity`: unknowns × observations; `outputs`: outputs × unknowns.
    pub fn new(
        sensitivity: &Mat<f64>,
        outputs: &Mat<f64>,
        sources: &[UncertaintySource],
        scale: TouchScale,
    ) -> Self {
        let sensitivity = outputs * sensitivity;
        let count = outputs.nrows();
        let mut covariance = Mat::zeros(count, count);
        let mut touch_variance = vec![0.0; count];
        let mut budget = Vec::new();
        for source in sources {
            let mut effect = &sensitivity * &source.factor;
            if is_touch_by_touch(source) {
                effect *= faer::Scale(scale.factor);
            }
            let share = &effect * effect.transpose();
            let variance: Vec<f64> = (0..count).map(|i| share[(i, i)]).collect();
            if is_touch_by_touch(source) {
                touch_variance.iter_mut().zip(&variance).for_each(|(sum, v)| *sum += v);
            }
            budget.push((source.name, variance.into_iter().map(f64::sqrt).collect()));
            covariance += share;
        }
        Self { covariance, budget, touch_variance }
    }

    pub fn u(&self, output: usize) -> f64 {
        self.covariance[(output, output)].max(0.0).sqrt()
    }

    /// Effective degrees of freedom; `None`: infinitely many.
    pub fn dof(&self, output: usize, scale: TouchScale) -> Option<f64> {
        let (all, touch) = (self.covariance[(output, output)], self.touch_variance[output]);
        let parts = [(touch, scale.dof?), (all - touch, f64::INFINITY)];
        Some(coverage::effective_dof(&parts)).filter(|dof| dof.is_finite())
    }
}

/// Radii disturbed by one draw of every source.
pub fn disturb(
    radii: &[f64],
    sources: &[UncertaintySource],
    scale: TouchScale,
    rng: &mut impl Rng,
) -> Vec<f64> {
    let mut disturbed = radii.to_vec();
    for source in sources {
        let draws: Vec<f64> = (0..source.factor.ncols()).map(|_| source.shape.draw(rng)).collect();
        let factor = if is_touch_by_touch(source) { scale.factor } else { 1.0 };
        for (r, change) in disturbed.iter_mut().zip(multiply(&source.factor, &draws)) {
            *r += factor * change;
        }
    }
    disturbed
}
