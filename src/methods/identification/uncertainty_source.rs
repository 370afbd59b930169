//! Sources of uncertainty. A draw is one independent random quantity of unit variance; a source states the change of
//! the observations by each of its draws.

use estimation::linear_least_squares::cholesky_lower;
use estimation::misfit::Misfit;
pub use estimation::monte_carlo::DrawDistribution;
use faer::Mat;
pub use machine::record::estimate::EvaluationType;
use machine::record::estimate::{Estimate, Parameter};
use nalgebra::{SMatrix, SVector};

/// Sources of type B that are independent in each run.
const INDEPENDENT_SOURCES: [&str; 6] = [
    "resolution",
    "resolution of the axes",
    "thermal drift",
    "change of the drift rate",
    "steps at interruptions",
    "what moved when interrupted",
];

/// Whether the source may have the same value in several runs. Every source of type B counts that is not known to be
/// independent in each run.
pub fn may_be_shared(name: &str, evaluation: EvaluationType) -> bool {
    evaluation == EvaluationType::B && !INDEPENDENT_SOURCES.contains(&name)
}

/// How χ² of the residuals treats a source; each treatment includes the one before it. The misfit scales a source if
/// the residuals can show its size (scatter of a touch). A source of certified size, or one that moves all observations
/// alike, is only expected in χ². A source that the unknowns absorb completely may be excluded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ResidualTreatment {
    /// χ² is evaluated without the source.
    ExcludedFromChi2,
    /// The source enters the expectation of χ²; its size remains as given.
    InExpectedChi2,
    /// The source enters the expectation of χ², and [`Misfit::uncertainty_factor`] scales its size.
    ScaledByMisfit,
}

/// Change of neighbouring observations by one draw.
#[derive(Debug, Clone, PartialEq)]
pub struct ObservationSpanChange {
    /// Index of the first changed observation.
    pub first_index: usize,
    /// Changes by one draw, mm: one entry per observation of the span.
    pub changes_mm: Vec<f64>,
}

/// Changes of the observations by independent draws of unit variance, mm.
#[derive(Debug, Clone, PartialEq)]
pub enum ObservationEffect {
    /// One independent random quantity per observation: the standard uncertainty of each.
    Independent(Vec<f64>),
    /// One independent random quantity per span of neighbouring observations.
    Spans(Vec<ObservationSpanChange>),
    /// One independent random quantity per column. A column has one entry per observation, starting with the first;
    /// missing entries are zero.
    Joint(Vec<Vec<f64>>),
}

/// A line of the uncertainty budget.
#[derive(Debug, Clone)]
pub struct UncertaintySource {
    /// Name in the budget.
    pub name: String,
    pub evaluation: EvaluationType,
    /// Distribution of each draw.
    pub draw_distribution: DrawDistribution,
    /// Degrees of freedom of the source's size; infinite for a declared size.
    pub dof: f64,
    pub residual_treatment: ResidualTreatment,
    /// Whether the source enters the weights of the observations.
    pub is_in_weights: bool,
    pub effect: ObservationEffect,
    /// Direct change of the unknowns by each draw, besides its effect on the observations: draws × unknowns,
    /// in the units of the unknowns. Empty: none.
    pub direct_unknown_changes: Vec<Vec<f64>>,
}

impl UncertaintySource {
    /// A normal Type B source with infinite degrees of freedom whose size the residuals scale and that enters the
    /// weights.
    pub fn new(name: impl Into<String>, effect: ObservationEffect) -> Self {
        Self {
            name: name.into(),
            evaluation: EvaluationType::B,
            draw_distribution: DrawDistribution::Normal,
            dof: f64::INFINITY,
            residual_treatment: ResidualTreatment::ScaledByMisfit,
            is_in_weights: true,
            effect,
            direct_unknown_changes: Vec::new(),
        }
    }

    /// A normal Type B source of joint draws that does not enter the weights.
    pub fn new_unweighted(name: impl Into<String>, columns: Vec<Vec<f64>>, in_residuals: ResidualTreatment) -> Self {
        Self {
            residual_treatment: in_residuals,
            is_in_weights: false,
            ..Self::new(name, ObservationEffect::Joint(columns))
        }
    }

    /// The source for the parameters `symbols` of an earlier estimate with their covariance. `columns[j]`:
    /// derivative of each observation by the parameter `symbols[j]`, mm per mm, rad, mm/mm or s. The source
    /// is expected in the residuals and does not enter the weights. `None`: the estimate lacks a parameter or
    /// the covariance.
    pub fn from_prior(prior: &Estimate, symbols: &[&str], columns: &[Vec<f64>]) -> Option<Self> {
        let parameters = find_parameters(prior, symbols)?;
        let columns = value_changes_by_prior_draws(prior, symbols, columns)?;
        Some(Self {
            dof: parameters.iter().filter_map(|p| p.dof).fold(f64::INFINITY, f64::min),
            ..Self::new_unweighted(format!("estimate of {}", prior.method), columns, ResidualTreatment::InExpectedChi2)
        })
    }

    /// Number of independent draws.
    pub fn draw_count(&self) -> usize {
        match &self.effect {
            ObservationEffect::Independent(sizes) => sizes.len(),
            ObservationEffect::Spans(spans) => spans.len(),
            ObservationEffect::Joint(columns) => columns.len(),
        }
    }

    /// Whether no draw changes anything.
    pub fn is_zero(&self) -> bool {
        let mut changes = (0..self.draw_count()).flat_map(|draw| self.draw_span(draw).1);
        changes.all(|change| *change == 0.0)
            && self.direct_unknown_changes.iter().flatten().all(|change| *change == 0.0)
    }

    /// The neighbouring observations that the draw number `draw` changes: index of the first, and the changes, mm.
    pub fn draw_span(&self, draw: usize) -> (usize, &[f64]) {
        match &self.effect {
            ObservationEffect::Independent(sizes) => (draw, &sizes[draw..=draw]),
            ObservationEffect::Spans(spans) => (spans[draw].first_index, &spans[draw].changes_mm),
            ObservationEffect::Joint(columns) => (0, &columns[draw]),
        }
    }

    /// A draw as a change of all `observations`, mm.
    pub fn observation_change(&self, draw: usize, observations: usize) -> Vec<f64> {
        let (first, values) = self.draw_span(draw);
        let mut change = vec![0.0; observations];
        let changed = change.iter_mut().skip(first);
        changed.zip(values).for_each(|(change, value)| *change = *value);
        change
    }

    /// Whether the effects of the source fit the given numbers of observations and unknowns.
    pub fn has_matching_size(&self, observations: usize, unknowns: usize) -> bool {
        let has_place = |draw| {
            let (first, values) = self.draw_span(draw);
            first + values.len() <= observations
        };
        let rows = &self.direct_unknown_changes;
        (0..self.draw_count()).all(has_place)
            && (rows.is_empty() || rows.len() == self.draw_count())
            && rows.iter().all(|row| row.len() == unknowns)
    }

    /// Factor from the misfit on the declared size of the source; 1 if the residuals do not scale the source.
    pub fn misfit_factor(&self, misfit: &Misfit) -> f64 {
        if self.residual_treatment == ResidualTreatment::ScaledByMisfit { misfit.uncertainty_factor } else { 1.0 }
    }
}

fn find_parameters<'a>(prior: &'a Estimate, symbols: &[&str]) -> Option<Vec<&'a Parameter>> {
    let find = |symbol: &&str| prior.parameters.iter().find(|parameter| parameter.symbol == *symbol);
    symbols.iter().map(find).collect()
}

/// Covariance of the parameters `symbols` in internal units (mm, rad, mm/mm, s). `None`: the estimate lacks a
/// parameter or the covariance.
pub fn prior_covariance(prior: &Estimate, symbols: &[&str]) -> Option<Mat<f64>> {
    let parameters = find_parameters(prior, symbols)?;
    let index = |p: &&Parameter| prior.covariance.symbols.iter().position(|s| *s == p.symbol);
    let indices: Vec<usize> = parameters.iter().map(index).collect::<Option<_>>()?;
    let edge: Vec<f64> = parameters.iter().map(|p| p.unit.to_reported_value(1.0)).collect();
    let mut covariance = Mat::zeros(edge.len(), edge.len());
    for (i, row) in indices.iter().enumerate() {
        for (j, column) in indices.iter().enumerate() {
            let entry = prior.covariance.rows.get(*row)?.get(*column)?;
            covariance[(i, j)] = entry / (edge[i] * edge[j]);
        }
    }
    Some(covariance)
}

/// Changes of the values by independent draws of the parameters `symbols` of an earlier estimate. `columns[j]`:
/// derivatives of the values by the parameter `symbols[j]`. `None`: the estimate lacks a parameter or the covariance.
pub fn value_changes_by_prior_draws(prior: &Estimate, symbols: &[&str], columns: &[Vec<f64>]) -> Option<Vec<Vec<f64>>> {
    let root = cholesky_lower(&prior_covariance(prior, symbols)?);
    Some((0..symbols.len()).map(|draw| linear_combination(columns, root.col_as_slice(draw))).collect())
}

/// Sum of the columns, each multiplied by its coefficient.
pub fn linear_combination(columns: &[Vec<f64>], coefficients: &[f64]) -> Vec<f64> {
    let mut sum = vec![0.0; columns.first().map_or(0, Vec::len)];
    for (column, coefficient) in columns.iter().zip(coefficients) {
        sum.iter_mut().zip(column).for_each(|(sum, value)| *sum += coefficient * value);
    }
    sum
}

/// Covariance, mm², of each of the first `blocks` blocks of `N` neighbouring observations, from the sources
/// that enter the weights, without the correlation between blocks. The weights are the inverses. Observations
/// after the last block are ignored.
pub fn block_covariances<const N: usize>(sources: &[UncertaintySource], blocks: usize) -> Vec<SMatrix<f64, N, N>> {
    let mut sums = vec![SMatrix::zeros(); blocks];
    for source in sources.iter().filter(|source| source.is_in_weights) {
        for draw in 0..source.draw_count() {
            let (mut first, mut rest) = source.draw_span(draw);
            while !rest.is_empty() && first / N < blocks {
                let offset = first % N;
                let (own, after) = rest.split_at(rest.len().min(N - offset));
                let mut part = SVector::<f64, N>::zeros();
                part.as_mut_slice()[offset..][..own.len()].copy_from_slice(own);
                sums[first / N] += part * part.transpose();
                (first, rest) = (first + own.len(), after);
            }
        }
    }
    sums
}
