//! Sources that would best explain a misfit if they were larger than declared.

use estimation::thin_svd::ThinSvd;
use faer::Mat;

use super::observation_model::SolvedModel;
use super::uncertainty_source::{ObservationEffect, UncertaintySource};

/// Maximum number of sources that are named.
const MAX_NAMED_MISFIT_CAUSES: usize = 3;
/// Minimum gain in log-likelihood for a source to be named.
const MIN_LOG_LIKELIHOOD_GAIN: f64 = 3.0;
/// Factors on the declared size that are tried, as exponents of √2.
const SIZE_FACTOR_SQRT2_EXPONENTS: std::ops::RangeInclusive<i32> = 1..=20;

/// A source that may be larger than declared.
#[derive(Debug, Clone)]
pub struct LikelyMisfitCause {
    pub name: String,
    /// Factor on the declared size of the source with the largest likelihood.
    pub size_factor: f64,
    /// Increase of the natural log-likelihood of the residuals by that factor.
    log_likelihood_gain: f64,
}

/// Up to `MAX_NAMED_MISFIT_CAUSES` sources with joint effects on many observations that may be larger than declared,
/// the most likely first.
pub fn find_likely_misfit_causes(solution: &SolvedModel<'_>, sources: &[UncertaintySource]) -> Vec<LikelyMisfitCause> {
    let mut list: Vec<LikelyMisfitCause> =
        sources.iter().filter_map(|source| evaluate_larger_source(solution, source)).collect();
    list.retain(|source| source.log_likelihood_gain >= MIN_LOG_LIKELIHOOD_GAIN);
    list.sort_by(|a, b| b.log_likelihood_gain.total_cmp(&a.log_likelihood_gain));
    list.truncate(MAX_NAMED_MISFIT_CAUSES);
    list
}

/// The factor on the size of the source that makes the residuals most likely. The weighted residuals have the
/// variance 1. A source with the singular values σ in the residuals, multiplied by f, gives the variance 1 + f²σ²
/// along its singular vectors. `None`: the source has no joint draws, or they do not appear in the residuals.
fn evaluate_larger_source(solution: &SolvedModel<'_>, source: &UncertaintySource) -> Option<LikelyMisfitCause> {
    if !matches!(source.effect, ObservationEffect::Joint(_)) {
        return None;
    }
    let (model, residuals) = (solution.model, solution.weighted_residuals);
    let of_draw =
        |draw| model.linear_response(&source.observation_change(draw, model.observation_count())).residual_changes;
    let columns: Vec<Vec<f64>> = (0..source.draw_count()).map(of_draw).collect();
    let left = Mat::from_fn(residuals.len(), columns.len(), |i, j| columns[j][i]);
    let svd = ThinSvd::decompose(&left);
    let along = |k: usize| -> f64 { (0..residuals.len()).map(|i| svd.u[(i, k)] * residuals[i]).sum() };
    let modes: Vec<(f64, f64)> = svd.s.iter().enumerate().map(|(k, sigma)| (*sigma, along(k).powi(2))).collect();
    let gain = |factor: f64| -> f64 {
        let of_mode = |(sigma, square): &(f64, f64)| {
            let more = (factor * sigma).powi(2);
            0.5 * (square * more / (1.0 + more) - more.ln_1p())
        };
        modes.iter().map(of_mode).sum()
    };
    let factors = SIZE_FACTOR_SQRT2_EXPONENTS.map(|power| 2f64.powf(f64::from(power) / 2.0));
    let best = factors.map(|factor| (factor, gain(factor)));
    let (factor, gain) = best.max_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(LikelyMisfitCause { name: source.name.clone(), size_factor: factor, log_likelihood_gain: gain })
}
