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
    pub machine_equations: CentresLeastSquares,
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
        let mut ranges = vec![(f64::INFINITY, f64::NEG_INFINITY); self.grouped.groups.len()];
        for (row, deviation) in self.grouped.centres.dwell_points.iter().zip(deviations) {
            let (least, most) = &mut ranges[row.group];
            (*least, *most) = (least.min(deviation), most.max(deviation));
        }
        ranges.into_iter().map(|(least, most)| most - least).collect()
    }
}
