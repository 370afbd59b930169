//! The solved identification with everything that the estimate reports.

use super::observe::ObservedScans;
use super::parameter_selection::ParameterSelection;
use super::pose_groups::GroupedScans;
use super::setup::LaserSetup;
use super::sphere_model::MachineEquations;
use crate::identification::Identification;
use estimation::nonlinear_least_squares::NonlinearSolution;

/// Inputs, both fits and uncertainties of an identification.
pub struct IdentificationResult<'a> {
    pub setup: &'a LaserSetup<'a>,
    pub observed: ObservedScans,
    pub grouped: GroupedScans,
    /// Fit of the sphere's centres and the beam.
    pub centre_fit: NonlinearSolution,
    pub selection: ParameterSelection,
    pub machine_equations: MachineEquations,
    /// Fit of the machine errors.
    pub machine_fit: NonlinearSolution,
    /// Names of the unknowns of `machine_fit`.
    pub unknown_names: Vec<String>,
    pub identification: Identification,
}

impl IdentificationResult<'_> {
    /// Form error of each pose group: largest minus smallest residual, mm.
    pub fn form_error_of_each_group_mm(&self) -> Vec<f64> {
        let deviations = self.grouped.centre_equations.surface_deviations_mm(&self.centre_fit.x);
        let mut ranges = vec![(f64::INFINITY, f64::NEG_INFINITY); self.grouped.groups.len()];
        for (row, deviation) in self.grouped.centre_equations.scan_points.iter().zip(deviations) {
            let (least, most) = &mut ranges[row.group_index];
            (*least, *most) = (least.min(deviation), most.max(deviation));
        }
        ranges.into_iter().map(|(least, most)| most - least).collect()
    }
}
