//! The solved identification with everything that the estimate reports.

use super::model::CentresLeastSquares;
use super::observe::ObservedScans;
use super::parameters::ParameterSelection;
use super::pose_groups::GroupedScans;
use super::setup::LaserSetup;
use crate::identification::Identification;
use estimation::nonlinear::NonlinearSolution;

pub struct IdentificationResult<'a> {
    pub setup: &'a LaserSetup<'a>,
    pub observed: ObservedScans,
    pub grouped: GroupedScans,
    /// Fit of the sphere's centres and the beam.
    pub centre_fit: NonlinearSolution,
    pub selection: ParameterSelection,
    pub problem: CentresLeastSquares,
    /// Fit of the machine errors.
    pub machine_fit: NonlinearSolution,
    /// Names of the unknowns of `machine_fit`.
    pub unknown_names: Vec<String>,
    pub identification: Identification,
}

impl IdentificationResult<'_> {
    /// Form error of each scan: largest less smallest residual, mm.
    pub fn form_errors_mm(&self) -> Vec<f64> {
        let deviations = self.grouped.centres.surface_deviations_mm(&self.centre_fit.x);
        let form_error = |group: usize| {
            let rows = self.grouped.centres.rows.iter().zip(&deviations);
            let group_deviations = rows.filter(|(row, _)| row.group == group).map(|(_, deviation)| *deviation);
            let (least, most) = group_deviations
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), deviation| (a.min(deviation), b.max(deviation)));
            most - least
        };
        (0..self.grouped.groups.len()).map(form_error).collect()
    }
}
