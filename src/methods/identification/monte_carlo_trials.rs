//! Monte Carlo propagation through the whole identification (JCGM 101), many trials at once.

use estimation::misfit::Misfit;
use estimation::monte_carlo::{DrawDistribution, DrawStream, TrialCount, TrialStatistics, propagate_distributions};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par};

use super::observation_model::ObservationModel;
use super::outputs::IdentificationOutputs;
use super::uncertainty_source::{ObservationEffect, UncertaintySource};
use crate::IdentifyError;

/// Number of trials and seed of their random streams. A fixed seed gives the same bytes for the same readings.
#[derive(Debug, Clone, Copy)]
pub struct TrialSettings {
    pub seed: u64,
    pub trial_count: TrialCount,
}

impl TrialSettings {
    /// `setting`: number of trials in the settings of the method; 0: until `stable_digits` digits are stable, at most
    /// `max_trials`.
    pub fn new(seed: u64, setting: usize, stable_digits: u32, max_trials: usize) -> Self {
        Self { seed, trial_count: TrialCount::from_setting(setting, stable_digits, max_trials) }
    }
}

/// A source prepared for drawing.
struct SampledSource<'a> {
    source: &'a UncertaintySource,
    /// Factor from the misfit on all draws of the source; 1 if the residuals do not scale the source.
    misfit_factor: f64,
    /// Index of the source's first draw among the draws of all sources.
    first_draw_index: usize,
    /// Draws × observations, for joint draws.
    joint_draws: Mat<f64>,
    /// Draws × values; no rows if no draw changes an unknown directly.
    direct_function_changes: Mat<f64>,
}

impl<'a> SampledSource<'a> {
    /// `slopes`: values × unknowns.
    fn new(source: &'a UncertaintySource, misfit: &Misfit, slopes: &Mat<f64>, first_draw_index: usize) -> Self {
        let joint_draws = match &source.effect {
            ObservationEffect::Joint(columns) => matrix_from_rows(columns),
            _ => Mat::new(),
        };
        let direct_function_changes = match source.direct_unknown_changes.as_slice() {
            [] => Mat::new(),
            changes => matrix_from_rows(changes) * slopes.transpose(),
        };
        let misfit_factor = source.misfit_factor(misfit);
        Self { source, misfit_factor, first_draw_index, joint_draws, direct_function_changes }
    }

    /// Adds the effect of this source to the observations (trials × observations). `unit_draws`: draws of
    /// unit variance, trials × draws of all sources, column-major.
    fn add_to_observations(&self, unit_draws: &[f64], changes: &mut Mat<f64>) {
        let trials = changes.nrows();
        if let ObservationEffect::Joint(_) = &self.source.effect {
            let own = self.source_unit_draws(unit_draws, trials);
            let changed = changes.subcols_mut(0, self.joint_draws.ncols());
            matmul(changed, Accum::Add, own, self.joint_draws.as_ref(), self.misfit_factor, Par::Seq);
            return;
        }
        for draw in 0..self.source.draw_count() {
            let (first, values) = self.source.draw_span(draw);
            let own = &unit_draws[(self.first_draw_index + draw) * trials..][..trials];
            for (i, value) in values.iter().enumerate() {
                let size = self.misfit_factor * value;
                let column = changes.col_as_slice_mut(first + i).iter_mut();
                column.zip(own).for_each(|(change, unit)| *change += size * unit);
            }
        }
    }

    /// Adds the direct effect of this source on the unknowns to the `values` (trials × values).
    fn add_direct_changes(&self, unit_draws: &[f64], values: &mut Mat<f64>) {
        if self.direct_function_changes.nrows() > 0 {
            let own = self.source_unit_draws(unit_draws, values.nrows());
            matmul(values, Accum::Add, own, self.direct_function_changes.as_ref(), self.misfit_factor, Par::Seq);
        }
    }

    /// The unit draws of this source, trials × draws.
    fn source_unit_draws<'u>(&self, unit_draws: &'u [f64], trials: usize) -> MatRef<'u, f64> {
        let draws = self.source.draw_count();
        let own = &unit_draws[self.first_draw_index * trials..][..draws * trials];
        MatRef::from_column_major_slice(own, trials, draws)
    }
}

/// A matrix with as many columns as the longest row; missing entries are zero.
fn matrix_from_rows(rows: &[Vec<f64>]) -> Mat<f64> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    Mat::from_fn(rows.len(), columns, |i, j| rows[i].get(j).copied().unwrap_or(0.0))
}

/// Trials of all parameters in the order of the estimate, internal units. Each trial draws the sources in the
/// order of the list, and within a source draw by draw. `misfit` scales the sources that
/// the residuals scale ([`ResidualTreatment`](super::ResidualTreatment)).
///
/// # Errors
/// Fewer than two trials.
pub fn propagate_by_trials(
    model: &dyn ObservationModel,
    sources: &[UncertaintySource],
    misfit: &Misfit,
    outputs: &IdentificationOutputs,
    settings: TrialSettings,
) -> Result<TrialStatistics, IdentifyError> {
    let shapes: Vec<DrawDistribution> =
        sources.iter().flat_map(|s| vec![s.draw_distribution; s.draw_count()]).collect();
    let slopes = outputs.trial_function_slopes(model.unknown_count());
    let mut drawn: Vec<SampledSource<'_>> = Vec::new();
    for source in sources {
        let first = drawn.last().map_or(0, |before| before.first_draw_index + before.source.draw_count());
        drawn.push(SampledSource::new(source, misfit, &slopes, first));
    }
    let compute = |random: &mut DrawStream, trials: usize| {
        let unit_draws = random.unit_variance_draws(trials, &shapes);
        let mut changes = Mat::zeros(trials, model.observation_count());
        drawn.iter().for_each(|source| source.add_to_observations(&unit_draws, &mut changes));
        let mut values = model.evaluate_each_perturbation(changes.as_ref(), slopes.as_ref());
        drawn.iter().for_each(|source| source.add_direct_changes(&unit_draws, &mut values));
        outputs.parameters_from_trial_functions(values)
    };
    propagate_distributions(settings.trial_count, settings.seed, outputs.all_parameters().count(), compute)
        .map_err(|reason| IdentifyError::IdentificationFailed(reason.to_string()))
}
