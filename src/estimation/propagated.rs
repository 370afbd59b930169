//! First-order propagation of sources of uncertainty to unknowns (JCGM 100).

use faer::Mat;

use super::coverage;
use super::misfit::Misfit;

pub struct Propagated {
    /// Unknowns × unknowns, in the units of the unknowns.
    pub covariance: Mat<f64>,
    /// Per source: standard uncertainty of each unknown.
    pub budget: Vec<(&'static str, Vec<f64>)>,
    /// Per unknown: variance from the sources whose size the residuals judge.
    shown: Vec<f64>,
}

impl Propagated {
    pub fn new(unknowns: usize) -> Self {
        let covariance = Mat::zeros(unknowns, unknowns);
        Self { covariance, budget: Vec::new(), shown: vec![0.0; unknowns] }
    }

    /// A source by what each of its independent draws does to the unknowns: columns of one standard
    /// uncertainty. `shown`: the residuals show it, and `misfit` corrects its size.
    pub fn add(&mut self, source: &'static str, shown: bool, draws: &[Vec<f64>], misfit: &Misfit) {
        let factor = if shown { misfit.factor } else { 1.0 };
        let effect = Mat::from_fn(self.shown.len(), draws.len(), |i, j| factor * draws[j][i]);
        let share = &effect * effect.transpose();
        let variance: Vec<f64> = (0..share.nrows()).map(|i| share[(i, i)]).collect();
        if shown {
            self.shown.iter_mut().zip(&variance).for_each(|(sum, v)| *sum += v);
        }
        self.budget.push((source, variance.into_iter().map(f64::sqrt).collect()));
        self.covariance += share;
    }

    pub fn u(&self, unknown: usize) -> f64 {
        self.covariance[(unknown, unknown)].max(0.0).sqrt()
    }

    /// Effective degrees of freedom; `None`: infinitely many.
    pub fn dof(&self, unknown: usize, misfit: &Misfit) -> Option<f64> {
        let (all, shown) = (self.covariance[(unknown, unknown)], self.shown[unknown]);
        let known = if misfit.factor == 1.0 { f64::INFINITY } else { misfit.dof };
        let parts = [(shown, known), (all - shown, f64::INFINITY)];
        Some(coverage::effective_dof(&parts)).filter(|dof| dof.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two sources of variances 4 and 1 on the first unknown; the residuals double the first's standard
    /// uncertainty, with 5 degrees of freedom: (16 + 1)²/(16²/5) = 5.645 (GUM, equation G.2b).
    #[test]
    fn what_the_residuals_judge_has_their_degrees_of_freedom() {
        let misfit =
            Misfit { chi2: 20.0, expected: 5.0, dof: 5.0, factor: 2.0, above: true, below: false };
        let mut propagated = Propagated::new(2);
        propagated.add("noise", true, &[vec![2.0, 0.0]], &misfit);
        propagated.add("radius", false, &[vec![0.6, 3.0], vec![0.8, 0.0]], &misfit);
        assert!((propagated.u(0) - 17f64.sqrt()).abs() < 1e-12);
        assert!((propagated.covariance[(0, 1)] - 1.8).abs() < 1e-12);
        assert_eq!(propagated.budget[0], ("noise", vec![4.0, 0.0]));
        let dof = propagated.dof(0, &misfit).unwrap();
        assert!((dof - 17.0 * 17.0 / (256.0 / 5.0)).abs() < 1e-9, "{dof}");
        assert_eq!(propagated.dof(1, &misfit), None);
    }
}
