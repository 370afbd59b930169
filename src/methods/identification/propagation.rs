//! First-order propagation of the sources to unknowns and outputs (JCGM 100), and the misfit.

use estimation::coverage::{coverage_factor, effective_dof};
use estimation::misfit::Misfit;
use estimation::monte_carlo::DrawDistribution;
use faer::Mat;
use machine::record::estimate::{BudgetLine, Distribution, EvaluationType};

use super::observation_model::{LinearResponse, SolvedModel};
use super::uncertainty_source::{ResidualTreatment, UncertaintySource, may_be_shared};

/// The effects of the sources on the unknowns.
pub struct Propagation {
    pub misfit: Misfit,
    /// Variance of each weighted residual from the declared sources that are expected in χ², before scaling by the
    /// misfit.
    pub residual_variances: Vec<f64>,
    effects: Vec<EffectOnUnknowns>,
    pub unknown_count: usize,
}

/// The effect of one source on the unknowns.
struct EffectOnUnknowns {
    name: String,
    evaluation: EvaluationType,
    distribution: Distribution,
    is_scaled_by_misfit: bool,
    /// Degrees of freedom of the size of the source.
    dof: f64,
    /// Change of the unknowns by draws of one standard deviation, unknowns × draws; with the misfit factor, if the
    /// residuals scale the source.
    changes_by_draw: Mat<f64>,
}

/// Effect of one source on outputs, in their internal units.
pub struct OutputEffect<'a> {
    pub source: &'a str,
    /// Outputs × draws.
    pub changes_by_draw: Mat<f64>,
}

/// Uncertainty of one output, in its internal unit.
#[derive(Debug, Clone)]
pub struct Uncertainty {
    /// Standard uncertainty.
    pub u: f64,
    /// Effective degrees of freedom; `None`: infinitely many.
    pub dof: Option<f64>,
    /// Standard uncertainty by source, internal unit, in the order of the sources.
    pub budget: Vec<BudgetLine>,
}

impl Uncertainty {
    /// Expanded uncertainty U = k·u, coverage probability 95.45 %.
    pub fn expanded(&self) -> f64 {
        coverage_factor(self.dof.unwrap_or(f64::INFINITY)) * self.u
    }
}

impl EffectOnUnknowns {
    /// Computes the effect of `source`. Appends the residuals of each draw to `left` if χ² is expected to
    /// contain them.
    fn new(solution: &SolvedModel<'_>, source: &UncertaintySource, left: &mut Vec<Vec<f64>>) -> Self {
        let model = solution.model;
        let mut draws = Mat::zeros(model.unknown_count(), source.draw_count());
        for draw in 0..source.draw_count() {
            let change = source.observation_change(draw, model.observation_count());
            let LinearResponse { mut unknown_changes, residual_changes } = model.linear_response(&change);
            let direct = source.direct_unknown_changes.get(draw).into_iter().flatten();
            unknown_changes.iter_mut().zip(direct).for_each(|(x, change)| *x += change);
            draws.col_as_slice_mut(draw).copy_from_slice(&unknown_changes);
            if source.residual_treatment >= ResidualTreatment::InExpectedChi2 {
                left.push(residual_changes);
            }
        }
        let is_scaled_by_misfit = source.residual_treatment == ResidualTreatment::ScaledByMisfit;
        let distribution = match source.draw_distribution {
            DrawDistribution::Normal => Distribution::Normal,
            DrawDistribution::Rectangular => Distribution::Rectangular,
        };
        let (name, evaluation, dof) = (source.name.clone(), source.evaluation, source.dof);
        Self { name, evaluation, distribution, is_scaled_by_misfit, dof, changes_by_draw: draws }
    }

    /// Variance of the output with this derivative by the unknowns. Only nonzero entries are visited, because
    /// most derivatives have few.
    fn output_variance(&self, slope: &[f64]) -> f64 {
        let entries: Vec<(usize, f64)> = slope.iter().copied().enumerate().filter(|(_, s)| *s != 0.0).collect();
        let along = |draw: &[f64]| -> f64 { entries.iter().map(|(j, s)| s * draw[*j]).sum() };
        (0..self.changes_by_draw.ncols()).map(|k| along(self.changes_by_draw.col_as_slice(k)).powi(2)).sum()
    }
}

impl Propagation {
    /// Propagates each draw by the response of the model, compares the residuals with the declared sources
    /// and scales the sources that the residuals scale by [`Misfit::uncertainty_factor`].
    pub fn new(solution: &SolvedModel<'_>, sources: &[UncertaintySource]) -> Self {
        let SolvedModel { model, weighted_residuals, has_declared_source_sizes, fit_quality, .. } = *solution;
        let mut left = Vec::new();
        let effects = sources.iter().map(|source| EffectOnUnknowns::new(solution, source, &mut left));
        let mut effects: Vec<EffectOnUnknowns> = effects.collect();
        let misfit = Misfit::from_residuals(weighted_residuals, &left, fit_quality.dof, has_declared_source_sizes);
        for effect in effects.iter_mut().filter(|effect| effect.is_scaled_by_misfit) {
            effect.changes_by_draw *= faer::Scale(misfit.uncertainty_factor);
        }
        let variance = |row: usize| left.iter().map(|draw| draw[row].powi(2)).sum();
        let residual_variances = (0..weighted_residuals.len()).map(variance).collect();
        Self { misfit, residual_variances, effects, unknown_count: model.unknown_count() }
    }

    /// Uncertainty of the output with this derivative by each unknown. The sources that the
    /// residuals scale are one component with the degrees of freedom of the misfit. Each other source is a
    /// component of its own (Welch–Satterthwaite, JCGM 100, G.4).
    pub fn output_uncertainty(&self, slope: &[f64]) -> Uncertainty {
        let variances: Vec<f64> = self.effects.iter().map(|e| e.output_variance(slope)).collect();
        let is_scaled = self.misfit.uncertainty_factor != 1.0;
        let mut scaled_variance = 0.0;
        let mut components = Vec::new();
        for (effect, variance) in self.effects.iter().zip(&variances) {
            match is_scaled && effect.is_scaled_by_misfit {
                true => scaled_variance += variance,
                false => components.push((*variance, effect.dof)),
            }
        }
        // The degrees of freedom of the misfit may be NaN if the misfit scales no source.
        components.extend(is_scaled.then_some((scaled_variance, self.misfit.effective_dof)));
        let lines = self.effects.iter().zip(&variances);
        let line = |(effect, variance): (&EffectOnUnknowns, &f64)| {
            let dof = if is_scaled && effect.is_scaled_by_misfit { self.misfit.effective_dof } else { effect.dof };
            BudgetLine {
                source: effect.name.clone(),
                evaluation_type: Some(effect.evaluation),
                distribution: Some(effect.distribution),
                u: variance.sqrt(),
                dof: Some(dof).filter(|dof| dof.is_finite()),
                ..BudgetLine::default()
            }
        };
        Uncertainty {
            u: variances.iter().sum::<f64>().sqrt(),
            dof: Some(effective_dof(&components)).filter(|dof| dof.is_finite()),
            budget: lines.map(line).collect(),
        }
    }

    /// Covariance (outputs × outputs) of the outputs with the derivatives `slopes` (outputs ×
    /// unknowns), in their internal units.
    pub fn output_covariance(&self, slopes: &Mat<f64>) -> Mat<f64> {
        let mut covariance = Mat::zeros(slopes.nrows(), slopes.nrows());
        for effect in &self.effects {
            let changes = slopes * &effect.changes_by_draw;
            covariance += &changes * changes.transpose();
        }
        covariance
    }

    /// Effects of the sources that other runs may share on the outputs with the derivatives `slopes` (outputs ×
    /// unknowns), outputs × draws, in their internal units.
    pub fn shareable_effects(&self, slopes: &Mat<f64>) -> Vec<OutputEffect<'_>> {
        let shareable = self.effects.iter().filter(|effect| may_be_shared(&effect.name, effect.evaluation));
        shareable
            .map(|effect| OutputEffect { source: &effect.name, changes_by_draw: slopes * &effect.changes_by_draw })
            .collect()
    }
}
