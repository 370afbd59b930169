//! Coverage factors and degrees of freedom (GUM, JCGM 100, annex G) and χ² bounds.

use statrs::distribution::{ChiSquared, ContinuousCDF, FisherSnedecor, Normal, StudentsT};

/// The probability of ±2 standard deviations of a normal distribution, 95.45 %.
pub const COVERAGE_PROBABILITY: f64 = 0.954_499_736_103_641_6;

/// From this number of degrees of freedom on, factors are computed by a series in 1/dof, exact to 1e-7, because the
/// inverse beta function loses digits.
const MIN_DOF_FOR_SERIES_EXPANSION: f64 = 1e4;

/// Coverage factor k for [`COVERAGE_PROBABILITY`]: 2 for `f64::INFINITY`, 2.65 for 5 effective degrees of freedom.
/// Without degrees of freedom (0, negative, NaN) k is infinite.
pub fn coverage_factor(dof: f64) -> f64 {
    if dof >= MIN_DOF_FOR_SERIES_EXPANSION {
        // Abramowitz & Stegun 26.7.5: z + (z³ + z)/(4·dof) with z = 2.
        return 2.0 + 2.5 / dof;
    }
    two_sided_t_factor(COVERAGE_PROBABILITY, dof)
}

/// t such that a Student variable with `dof` degrees of freedom lies within ±t with `probability`. The result is
/// infinite if `dof` is not positive, and that of the normal distribution if `dof` is `f64::INFINITY`.
pub fn two_sided_t_factor(probability: f64, dof: f64) -> f64 {
    let upper = 0.5 * (1.0 + probability);
    if dof >= MIN_DOF_FOR_SERIES_EXPANSION {
        let z = Normal::standard().inverse_cdf(upper);
        // The same expansion as in [`coverage_factor`].
        return z + (z.powi(3) + z) / (4.0 * dof);
    }
    StudentsT::new(0.0, 1.0, dof).map_or(f64::INFINITY, |student| student.inverse_cdf(upper))
}

/// Probability that a Student variable with `dof` degrees of freedom is below `t`. The normal distribution is used
/// for 10⁴ degrees of freedom or more. The result is NaN if `dof` is not positive.
pub fn student_t_cdf(t: f64, dof: f64) -> f64 {
    if dof >= MIN_DOF_FOR_SERIES_EXPANSION {
        return Normal::standard().cdf(t);
    }
    StudentsT::new(0.0, 1.0, dof).map_or(f64::NAN, |student| student.cdf(t))
}

/// Effective degrees of freedom of u² = Σu_i² (GUM equation G.2b, Welch–Satterthwaite) for
/// `(u_i², dof_i)`. A component with an exactly known u_i has `f64::INFINITY` degrees of freedom.
pub fn effective_dof(variances_and_dofs: &[(f64, f64)]) -> f64 {
    let combined: f64 = variances_and_dofs.iter().map(|(variance, _)| variance).sum();
    let spread: f64 = variances_and_dofs.iter().map(|(variance, dof)| variance * variance / dof).sum();
    if spread > 0.0 { combined * combined / spread } else { f64::INFINITY }
}

/// Bounds within which χ² with `dof` degrees of freedom lies with `probability`, with equal tails. `None` for a `dof`
/// that is not positive and finite, or a probability outside (0, 1).
pub fn chi_square_bounds(dof: f64, probability: f64) -> Option<(f64, f64)> {
    let distribution = ChiSquared::new(dof).ok().filter(|_| dof.is_finite())?;
    let tail = 0.5 * (1.0 - probability);
    let inside = tail > 0.0 && tail < 0.5;
    inside.then(|| (distribution.inverse_cdf(tail), distribution.inverse_cdf(1.0 - tail)))
}

/// Probability that χ² with `dof` degrees of freedom is above `chi2`; NaN for a `dof` that is not positive.
pub fn chi_square_tail(chi2: f64, dof: f64) -> f64 {
    ChiSquared::new(dof).map_or(f64::NAN, |distribution| distribution.sf(chi2))
}

/// One-sided bound that the ratio of two sample variances of the same normal distribution, numerator by denominator,
/// does not exceed with `probability` (quantile of F). `None` for degrees of freedom that are not positive or a
/// probability outside (0, 1).
pub fn variance_ratio_bound(probability: f64, numerator_dof: f64, denominator_dof: f64) -> Option<f64> {
    let distribution = FisherSnedecor::new(numerator_dof, denominator_dof).ok()?;
    let inside = probability > 0.0 && probability < 1.0;
    inside.then(|| distribution.inverse_cdf(probability)).filter(|bound| bound.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// GUM table G.2, column 95.45 %.
    #[test]
    fn paper_gum_table_g2_coverage_factors() {
        for (dof, k) in
            [(1.0, 13.97), (2.0, 4.53), (3.0, 3.31), (5.0, 2.65), (8.0, 2.37), (10.0, 2.28), (20.0, 2.13), (50.0, 2.05)]
        {
            assert!((coverage_factor(dof) - k).abs() <= 0.0051, "{dof} {}", coverage_factor(dof));
        }
        assert_eq!(coverage_factor(f64::INFINITY), 2.0);
        assert!(
            (coverage_factor(0.999 * MIN_DOF_FOR_SERIES_EXPANSION) - coverage_factor(MIN_DOF_FOR_SERIES_EXPANSION))
                .abs()
                < 1e-6
        );
        assert_eq!(coverage_factor(0.0), f64::INFINITY);
        assert_eq!(coverage_factor(f64::NAN), f64::INFINITY);
    }

    /// Tables of the normal distribution (95 %, 99.73 %), of Student's t, and continuity where the expansion
    /// begins.
    #[test]
    fn two_sided_t_factors_agree_with_tables() {
        assert!((two_sided_t_factor(0.95, f64::INFINITY) - 1.959_964).abs() < 1e-6);
        assert!((two_sided_t_factor(0.997_300_204, f64::INFINITY) - 3.0).abs() < 1e-6);
        assert!((two_sided_t_factor(0.95, 10.0) - 2.228_139).abs() < 1e-5);
        assert!(
            (two_sided_t_factor(0.99, 0.999 * MIN_DOF_FOR_SERIES_EXPANSION)
                - two_sided_t_factor(0.99, MIN_DOF_FOR_SERIES_EXPANSION))
            .abs()
                < 1e-6
        );
        assert_eq!(two_sided_t_factor(0.95, f64::NAN), f64::INFINITY);
    }

    /// GUM example H.1.6: components in nm and their degrees of freedom give 16.
    #[test]
    fn paper_gum_example_h1_effective_dof() {
        let components = [(25.0_f64, 18.0), (9.7, 25.6), (2.9, 50.0), (16.6, 2.0)];
        let components = components.map(|(u, dof)| (u * u, dof));
        assert!((effective_dof(&components) - 16.7).abs() < 0.3, "{}", effective_dof(&components));
        assert_eq!(effective_dof(&[(1.0, f64::INFINITY)]), f64::INFINITY);
        assert!((effective_dof(&[(3.0, 5.0)]) - 5.0).abs() < 1e-12);
    }

    /// Tables of the χ² distribution: 2.5 % and 97.5 % points.
    #[test]
    fn chi_square_bounds_agree_with_tables() {
        let (low, high) = chi_square_bounds(10.0, 0.95).unwrap();
        assert!((low - 3.247).abs() < 1e-3 && (high - 20.483).abs() < 1e-3);
        assert_eq!(chi_square_bounds(0.0, 0.95), None);
        assert_eq!(chi_square_bounds(5.0, 1.0), None);
        // Upper 5 % and 1 % points.
        assert!((chi_square_tail(18.307, 10.0) - 0.05).abs() < 1e-5);
        assert!((chi_square_tail(6.635, 1.0) - 0.01).abs() < 1e-5 && chi_square_tail(1.0, 0.0).is_nan());
    }

    /// Tables of the F distribution: 99 % and 95 % points.
    #[test]
    fn variance_ratio_bounds_agree_with_tables() {
        for (probability, dof, dof_below, bound) in
            [(0.99, 10.0, 10.0, 4.849), (0.99, 5.0, 20.0, 4.103), (0.95, 8.0, 2.0, 19.371)]
        {
            let found = variance_ratio_bound(probability, dof, dof_below).unwrap();
            assert!((found - bound).abs() < 1e-3, "{found} {bound}");
        }
        assert_eq!(variance_ratio_bound(0.99, 0.0, 5.0), None);
        assert_eq!(variance_ratio_bound(1.0, 5.0, 5.0), None);
    }
}
