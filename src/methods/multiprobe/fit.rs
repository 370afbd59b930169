//! Weighted least squares, harmonic by harmonic.

use std::ops::Deref;

use estimation::revolutions::{ChannelAtMounting, HarmonicData};

use super::model::ProbeLayout;
use crate::IdentifyError;
use crate::identification::{BlockEquations, BlockFit, BlockwiseFit, multiply_vector};

/// Fit of all harmonics from 1 on; each harmonic is one block. The observations of a channel form a group. Each group
/// is reduced to the components that a motion or a form can explain.
pub struct SeparationFit(BlockwiseFit);

impl Deref for SeparationFit {
    type Target = BlockwiseFit;

    fn deref(&self) -> &BlockwiseFit {
        &self.0
    }
}

impl SeparationFit {
    /// # Errors
    /// A value is not finite.
    pub fn new(layout: &ProbeLayout, data: &HarmonicData) -> Result<Self, IdentifyError> {
        let channels: Vec<usize> = data.row_keys.iter().map(|row| row.channel_index).collect();
        let equations = |order: usize| BlockEquations {
            design_matrix: layout.design_matrix(&data.row_keys, order),
            unknown_names: layout.unknown_names(order),
            observations_mm: data.observations(order),
            sigma_mm: data.observation_std_u_mm(order),
            reduction_group_indices: channels.repeat(2),
        };
        BlockwiseFit::new((1..=data.max_order()).map(equations)).map(Self)
    }

    /// Σ(residual/σ)² of all observations with their degrees of freedom. The first harmonic is omitted: it contains
    /// the eccentricity of each mounting, which is not in the model.
    pub fn chi2_and_dof(&self) -> (f64, usize) {
        let higher = self.blocks.iter().skip(1);
        higher.fold((0.0, 0), |(chi2, dof), fit| (chi2 + fit.chi2, dof + fit.dof))
    }

    /// Observations that the solution predicts with another layout: harmonic by harmonic from 1 on, the cosine parts
    /// of all rows, then the sine parts, mm.
    pub fn predicted_observations(&self, layout: &ProbeLayout, rows: &[ChannelAtMounting]) -> Vec<f64> {
        let block_observations =
            |(order, fit): (usize, &BlockFit)| multiply_vector(&layout.design_matrix(rows, order), &fit.solution.x);
        (1..).zip(&self.blocks).flat_map(block_observations).collect()
    }

    /// Σ(difference/σ)² between the observations that the solution predicts with another layout and
    /// `other_observations`, without the first harmonic. `other_observations` are measured, or predicted for another
    /// layout.
    pub fn difference_chi2(&self, layout: &ProbeLayout, data: &HarmonicData, other_observations: &[f64]) -> f64 {
        let sigma = (1..=data.max_order()).flat_map(|order| data.observation_std_u_mm(order));
        let predicted = self.predicted_observations(layout, &data.row_keys);
        let all = predicted.iter().zip(other_observations).zip(sigma).skip(2 * data.row_keys.len());
        all.map(|((predicted, other), sigma)| ((other - predicted) / sigma).powi(2)).sum()
    }
}
