//! Both fits combined in one observation model: the sphere's centres from the dwell points, then the machine from
//! the centres.

use faer::{Mat, MatRef};
use nalgebra::Matrix3;

use super::centre_equations::CentreEquations;
use super::pose_groups::PoseGroup;
use super::sphere_model::MachineEquations;
use crate::identification::{
    LinearResponse, NonlinearFit, ObservationEffect, ObservationModel, UncertaintySource, block_covariances,
    multiply_vector, solve_each_trial,
};

/// Standard uncertainty added in quadrature to that of each centre, to limit the weight of the centre, mm.
const ADDED_CENTRE_STD_U_MM: f64 = 1e-6;

/// Observations: the distance of each dwell point from its centre. Unknowns: machine, zero point and sphere; the
/// beam; the latency, which only the sources change.
pub struct CombinedFit<'a> {
    pub centre_fit: NonlinearFit<'a, CentreEquations>,
    /// Gain of the first fit: unknowns of `centre_fit` × dwell points.
    pub centre_gain_matrix: &'a Mat<f64>,
    pub machine_fit: NonlinearFit<'a, MachineEquations>,
    pub groups: &'a [PoseGroup],
    /// Number of unknowns of the latency model: the latency, and the lost motion of each moved axis; 0 without
    /// continuous scans.
    pub latency_unknown_count: usize,
}

impl CombinedFit<'_> {
    /// Changes of the centres in the table frame, three coordinates per group, for a change of the unknowns of the
    /// first fit.
    fn centre_changes_in_table(&self, change: &[f64]) -> Vec<f64> {
        let groups = self.groups.iter().enumerate();
        let coordinates = groups.flat_map(|(i, group)| -> [f64; 3] {
            (group.machine_from_table.inverse() * self.centre_fit.equation.group_centre(change, i)).into()
        });
        coordinates.collect()
    }

    /// Unknowns of machine and beam; those of the latency are 0, because no observation changes them.
    fn join_unknowns(&self, mut machine: Vec<f64>, centres: &[f64]) -> Vec<f64> {
        machine.extend(&centres[..self.centre_fit.equation.beam_unknown_count()]);
        machine.resize(self.unknown_count(), 0.0);
        machine
    }
}

impl ObservationModel for CombinedFit<'_> {
    fn observation_count(&self) -> usize {
        self.centre_fit.observation_count()
    }

    /// Unknowns of machine, beam and latency model, without the centres of the groups.
    fn unknown_count(&self) -> usize {
        self.machine_fit.unknown_count() + self.centre_fit.equation.beam_unknown_count() + self.latency_unknown_count
    }

    fn linear_response(&self, change: &[f64]) -> LinearResponse {
        let centres = multiply_vector(self.centre_gain_matrix, change);
        let response = self.machine_fit.linear_response(&self.centre_changes_in_table(&centres));
        LinearResponse { unknown_changes: self.join_unknowns(response.unknown_changes, &centres), ..response }
    }

    fn leverage(&self) -> Vec<f64> {
        self.machine_fit.leverage()
    }

    fn unknowns_for_each_perturbation(&self, changes: MatRef<'_, f64>) -> Mat<f64> {
        solve_each_trial(changes, self.unknown_count(), |change| {
            let x = self.centre_fit.unknowns_for_changed_observations(change);
            let solved = self.centre_fit.minimum.x.iter();
            let moved: Vec<f64> = x.iter().zip(solved).map(|(x, solved)| x - solved).collect();
            self.join_unknowns(
                self.machine_fit.unknowns_for_changed_observations(&self.centre_changes_in_table(&moved)),
                &x,
            )
        })
    }
}

/// Derivative of the unknowns by each observation, per mm: unknowns × observations.
pub fn observation_sensitivities(fit: &impl ObservationModel) -> Mat<f64> {
    let mut gain = Mat::zeros(fit.unknown_count(), fit.observation_count());
    let mut change = vec![0.0; fit.observation_count()];
    for j in 0..fit.observation_count() {
        change[j] = 1.0;
        gain.col_as_slice_mut(j).copy_from_slice(&fit.linear_response(&change).unknown_changes);
        change[j] = 0.0;
    }
    gain
}

/// Covariance of each centre in the machine frame, from the sources that enter the weights.
pub fn centre_covariances(
    centres: &CentreEquations,
    gain: &Mat<f64>,
    sources: &[UncertaintySource],
) -> Vec<Matrix3<f64>> {
    let centre_changes = |change: Vec<f64>| {
        let x = multiply_vector(gain, &change);
        (0..centres.group_count).flat_map(|i| <[f64; 3]>::from(centres.group_centre(&x, i))).collect()
    };
    let changes = sources
        .iter()
        .filter(|source| source.is_in_weights)
        .flat_map(|source| (0..source.draw_count()).map(|draw| source.observation_change(draw, gain.ncols())));
    let source = UncertaintySource::new("centres", ObservationEffect::Joint(changes.map(centre_changes).collect()));
    let mut covariances = block_covariances(&[source], centres.group_count);
    let least = Matrix3::from_diagonal_element(ADDED_CENTRE_STD_U_MM.powi(2));
    covariances.iter_mut().for_each(|covariance| *covariance += least);
    covariances
}
