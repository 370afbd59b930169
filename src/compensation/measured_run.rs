//! A run as a verification uses it, and the joint coverage of its comparisons.

use estimation::coverage::coverage_factor;
use machine::kinematics::ErrorTerm;
use machine::record::estimate::Estimate;
use machine::record::event::RunEvent;
use machine::record::tool_centre::ToolCentreReading;
use methods::MethodRefusal;
use methods::compensation::{ControlModel, MeasuredAxisPositions, joint_coverage_ratio};
use methods::identification::StatedStylusUncertainty;
use methods::prediction::{ErrorPredictor, WorkZero};

use super::proposal::stated_stylus_uncertainty;
use crate::setup::MachineFile;
use crate::store::StoredRun;

/// One of the two runs of a verification, with its estimate.
pub(super) struct MeasuredRun<'a> {
    pub(super) stored: &'a StoredRun,
    estimate: &'a Estimate,
    stylus: StatedStylusUncertainty,
}

impl<'a> MeasuredRun<'a> {
    pub(super) fn new(stored: &'a StoredRun, estimate: &'a Estimate, file: &MachineFile) -> Self {
        Self { stored, estimate, stylus: stated_stylus_uncertainty(&stored.plan, estimate, file) }
    }

    pub(super) fn positions(&self) -> Result<MeasuredAxisPositions<'a>, MethodRefusal> {
        MeasuredAxisPositions::new(&self.stored.plan.machine, self.stylus, self.estimate)
    }

    /// Errors of the tool that remain while the control takes the errors `compensated` into account.
    pub(super) fn predictor(&self, compensated: Vec<ErrorTerm>) -> Result<ErrorPredictor<'a>, MethodRefusal> {
        let predictor =
            ErrorPredictor::new(&self.stored.plan.machine, self.stylus, self.estimate, WorkZero::TableOrigin)?;
        Ok(predictor.with_compensated_errors(compensated))
    }

    /// Readings of the tool centre, with their steps.
    pub(super) fn tool_centre_readings(&self) -> Vec<(u32, &'a ToolCentreReading)> {
        let readings = self.stored.events.iter().filter_map(|(_, event)| match event {
            RunEvent::ToolCentreRead { step, reading, .. } => Some((*step, reading)),
            _ => None,
        });
        readings.collect()
    }

    /// Smallest degrees of freedom of the identifiable parameters; infinite if none states them.
    fn smallest_dof(&self) -> f64 {
        let dofs = self.estimate.parameters.iter().filter(|own| own.identifiable).filter_map(|own| own.dof);
        dofs.fold(f64::INFINITY, f64::min)
    }
}

/// All comparisons of a verification hold together with the probability 95.45 %.
#[derive(Debug, Clone, Copy)]
pub(super) struct JointCoverage {
    /// Positions and travels that the values correct, and, if the values set the tool centre, three for each
    /// reading of the tool centre in the second run.
    comparison_count: usize,
    /// Smallest degrees of freedom of both estimates.
    dof: f64,
}

impl JointCoverage {
    pub(super) fn new([first, second]: [&MeasuredRun<'_>; 2], control: &ControlModel, sets_tool_centre: bool) -> Self {
        let reading_count = if sets_tool_centre { second.tool_centre_readings().len() } else { 0 };
        Self {
            comparison_count: control.quantity_count() + 3 * reading_count,
            dof: first.smallest_dof().min(second.smallest_dof()),
        }
    }

    /// Factor on the expanded uncertainty (95.45 %) of one comparison, so that all comparisons hold together.
    pub(super) fn ratio(self) -> f64 {
        joint_coverage_ratio(self.comparison_count, self.dof)
    }

    /// Coverage factor of a standard uncertainty for all comparisons together.
    pub(super) fn factor(self) -> f64 {
        self.ratio() * coverage_factor(self.dof)
    }
}
