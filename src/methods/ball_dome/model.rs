//! The results of the variants as functions of the observations: X, Y, Z of each measurement (machine frame,
//! mm), the errors of the prior, then the certified positions of all balls (artefact frame, mm).

use faer::{Mat, MatRef};
use nalgebra::{Matrix3, Vector3};

use super::measured_points::MeasuredPoints;
use super::variant::{DomeVariant, InputChanges};
use crate::identification::{LinearResponse, ObservationModel, solve_each_trial};

pub struct DomeModel<'a> {
    pub points: &'a MeasuredPoints,
    pub variants: &'a [DomeVariant],
    /// Derivative of each point by the errors of the prior, table frame: points × errors.
    pub point_derivatives_by_prior_errors: &'a [Vec<Vector3<f64>>],
    /// Number of balls of the artefact, those without measurement included.
    pub ball_count: usize,
    /// Index of the variant whose deviations are compared with the declared sources. `None`: no variant is compared.
    pub chi2_variant_index: Option<usize>,
    /// Indices of the points of each group. The mean deviation of a group is a result of each variant.
    pub group_point_indices: &'a [Vec<usize>],
    /// Weight of each point: from its deviation in the table frame to weighted residuals.
    pub whitening_matrices: &'a [Matrix3<f64>],
}

impl DomeModel<'_> {
    /// Number of errors of the prior.
    fn prior_error_count(&self) -> usize {
        self.point_derivatives_by_prior_errors.first().map_or(0, Vec::len)
    }

    /// Index of the observation of an error of the prior.
    pub fn error_observation_index(&self, error: usize) -> usize {
        3 * self.points.point_count() + error
    }

    /// Index of the first of the three observations of a certified position.
    pub fn first_certified_observation_index(&self, ball: usize) -> usize {
        self.error_observation_index(self.prior_error_count()) + 3 * ball
    }

    fn input_changes<'c>(&self, change: &'c [f64]) -> InputChanges<'c> {
        let vector = |at: usize| Vector3::from_column_slice(&change[at..at + 3]);
        let table_from_axes = self.points.table_from_axes.iter().enumerate();
        let errors = &change[self.error_observation_index(0)..self.first_certified_observation_index(0)];
        let by_errors =
            |columns: &Vec<Vector3<f64>>| columns.iter().zip(errors).map(|(column, error)| column * *error).sum();
        InputChanges {
            points_mm: table_from_axes.map(|(i, into)| into * vector(3 * i)).collect(),
            points_by_prior_errors_mm: self.point_derivatives_by_prior_errors.iter().map(by_errors).collect(),
            prior_errors: errors,
            certified_positions_mm: self
                .points
                .ball_indices
                .iter()
                .map(|ball| vector(self.first_certified_observation_index(*ball)))
                .collect(),
        }
    }

    /// Changes of the deviations and of the stylus of each variant.
    fn deviation_and_stylus_changes_of_variants(&self, change: &[f64]) -> Vec<(Vec<Vector3<f64>>, Vector3<f64>)> {
        let changes = self.input_changes(change);
        self.variants.iter().map(|variant| variant.first_order_deviation_and_stylus_changes(&changes)).collect()
    }

    /// Largest and mean deviation of each variant, then the fitted styluses, then the mean deviations of the groups,
    /// variant by variant, mm: after the `change` of the observations. The deviation vectors change to first order;
    /// their lengths are exact.
    pub fn result_values(&self, change: &[f64]) -> Vec<f64> {
        let changes = self.deviation_and_stylus_changes_of_variants(change);
        let norms = |(variant, (moved, _)): (&DomeVariant, &(Vec<Vector3<f64>>, Vector3<f64>))| {
            let deviations = variant.certified_to_measured_fit.deviations.iter().zip(moved);
            deviations.map(|(d, by)| (d + by).norm()).collect()
        };
        let norms: Vec<Vec<f64>> = self.variants.iter().zip(&changes).map(norms).collect();
        let of_variant = |norms: &Vec<f64>| [norms.iter().copied().fold(0.0, f64::max), mean_value(norms)];
        let mut values: Vec<f64> = norms.iter().flat_map(of_variant).collect();
        for (variant, (_, stylus)) in self.variants.iter().zip(&changes) {
            let fitted = variant.has_fitted_stylus().then_some(variant.stylus.vector_mm + stylus);
            values.extend(fitted.iter().flatten());
        }
        values.extend(norms.iter().flat_map(|norms| self.group_means(norms)));
        values
    }

    /// Mean value of each group.
    fn group_means(&self, values: &[f64]) -> Vec<f64> {
        let of = |group: &Vec<usize>| group.iter().map(|i| values[*i]).sum::<f64>() / group.len().max(1) as f64;
        self.group_point_indices.iter().map(of).collect()
    }

    /// Index of the mean deviation of a group in [`Self::result_values`].
    pub fn group_mean_value_index(&self, variant: usize, group: usize) -> usize {
        let styluses = self.variants.iter().filter(|variant| variant.has_fitted_stylus()).count();
        2 * self.variants.len() + 3 * styluses + variant * self.group_point_indices.len() + group
    }

    /// Three weighted residuals for each point, of unit variance by the sources of the readings alone.
    pub fn weighted_residuals(&self, deviations: &[Vector3<f64>]) -> Vec<f64> {
        let rows = self.whitening_matrices.iter().zip(deviations).map(|(weight, d)| weight * d);
        rows.flat_map(|row| [row.x, row.y, row.z]).collect()
    }
}

fn mean_value(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

impl ObservationModel for DomeModel<'_> {
    /// Three for each measurement, one for each error of the prior, three for each ball of the artefact.
    fn observation_count(&self) -> usize {
        self.first_certified_observation_index(self.ball_count)
    }

    /// Number of values of `result_values`.
    fn unknown_count(&self) -> usize {
        self.group_mean_value_index(self.variants.len(), 0)
    }

    /// First-order changes of the results: the norm of a vector changes by the component of its change along the
    /// vector.
    fn linear_response(&self, change: &[f64]) -> LinearResponse {
        let changes = self.deviation_and_stylus_changes_of_variants(change);
        let mut unknowns = Vec::with_capacity(self.unknown_count());
        let mut means = Vec::new();
        for (variant, (moved, _)) in self.variants.iter().zip(&changes) {
            let deviations = &variant.certified_to_measured_fit.deviations;
            let along = |(d, by): (&Vector3<f64>, &Vector3<f64>)| d.dot(by) / d.norm().max(f64::MIN_POSITIVE);
            let largest = deviations.iter().zip(moved).max_by(|a, b| a.0.norm().total_cmp(&b.0.norm()));
            unknowns.push(largest.map_or(0.0, along));
            let each: Vec<f64> = deviations.iter().zip(moved).map(along).collect();
            unknowns.push(mean_value(&each));
            means.extend(self.group_means(&each));
        }
        for (variant, (_, stylus)) in self.variants.iter().zip(&changes) {
            unknowns.extend(variant.has_fitted_stylus().then_some(*stylus).iter().flatten());
        }
        unknowns.extend(means);
        let residuals = self.chi2_variant_index.map_or(Vec::new(), |index| self.weighted_residuals(&changes[index].0));
        LinearResponse { unknown_changes: unknowns, residual_changes: residuals }
    }

    fn unknowns_for_each_perturbation(&self, changes: MatRef<'_, f64>) -> Mat<f64> {
        solve_each_trial(changes, self.unknown_count(), |change| self.result_values(change))
    }
}
