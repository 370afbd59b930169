//! The proposal of new values for a control from a stored run.

use jiff::Timestamp;
use serde::Serialize;

use super::target::{CompensationTarget, TargetError};
use super::targets::open_target;
use super::values_record::records_same_values;
use crate::setup::{ControlConfig, MachineFile, MachineFileError};
use crate::store::{Journal, RunId, StoreError, StoredEstimate, StoredRun, sha256_of_json};
use machine::Axis;
use machine::kinematics::{ErrorParameter, KinematicChain};
use machine::record::estimate::{Estimate, Parameter, Unit, Verdict};
use machine::record::machine::Machine;
use machine::record::plan::Plan;
use methods::MethodRefusal;
use methods::compensation::{
    ControlModel, MeasuredAxisPositions, Proposal, ProposalOptions, ProposedPosition, ProposedTravel,
    RotaryAxisCoordinate, propose,
};
use methods::identification::StatedStylusUncertainty;
use methods::prediction::{ErrorPredictor, WorkZero};

#[derive(Debug, thiserror::Error)]
pub enum ControlProposalError {
    #[error(transparent)]
    Journal(#[from] StoreError),
    #[error(transparent)]
    Target(#[from] TargetError),
    #[error(transparent)]
    Method(#[from] MethodRefusal),
    #[error("run {0} has no estimate")]
    NoEstimate(RunId),
    #[error("the readings of run {0} contradict the model: no uncertainty is reliable, and nothing is proposed")]
    ContradictedModel(RunId),
    #[error("run {run} measured the machine `{measured}`; the machine file is of `{stated}`")]
    OtherMachine { run: RunId, measured: String, stated: String },
    #[error("axes, stylus or active compensations in the machine file differ from those of run {0}")]
    ChangedMachine(RunId),
    #[error("the machine file of run {run} cannot be read: {error}")]
    UnreadableMachineFile { run: RunId, error: Box<MachineFileError> },
    #[error("run {0} was measured on a simulated control")]
    Simulated(RunId),
    /// The run recorded other values than the present ones, or none.
    #[error(
        "the record of run {run} does not confirm that the control used its present compensation values ({kind}) \
         during the run: the readings contain the effect of these values, and an error could be corrected twice"
    )]
    CompensationValuesMismatch { run: RunId, kind: &'static str },
    #[error("the proposal cannot be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
    #[error("the sheet cannot be written: {0}")]
    Template(#[from] minijinja::Error),
    #[error("the sheet cannot be written: {0}")]
    Csv(#[from] std::io::Error),
}

impl ControlProposalError {
    /// Remedy to show to the user.
    pub fn remedy(&self) -> String {
        match self {
            Self::Journal(error) => error.remedy().to_owned(),
            Self::Target(error) => error.remedy(),
            Self::Method(refusal) => refusal.remedy.clone(),
            Self::NoEstimate(run) => {
                format!("identify the run with `trued identify --run {run}`, or choose another run")
            }
            Self::ContradictedModel(run) => {
                format!("read the warnings with `trued show {run}`, remove the cause, and measure again")
            }
            Self::OtherMachine { .. } => "give the machine file of this machine with --machine".to_owned(),
            Self::CompensationValuesMismatch { .. } => {
                "if a compensation is unfinished, finish it; then measure again".to_owned()
            }
            Self::ChangedMachine(_) => "measure again with this machine file".to_owned(),
            Self::UnreadableMachineFile { .. } => "measure again with this version of the program".to_owned(),
            Self::Simulated(_) => "measure on the machine".to_owned(),
            Self::Json(_) | Self::Template(_) | Self::Csv(_) => "report this error".to_owned(),
        }
    }
}

/// An error of the axes that is not corrected, in its unit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RemainingAxisError {
    pub symbol: String,
    pub value: f64,
    #[serde(rename = "U")]
    pub expanded: f64,
    pub unit: Unit,
}

/// Largest position error of the tool relative to the work zero over the measured ranges, with tool centre point
/// control, µm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PredictedToolError {
    pub largest_um: f64,
    /// U (k = 2) of `largest_um`.
    #[serde(rename = "U_largest_um")]
    pub expanded_largest_um: f64,
}

/// New compensation values for a control, with their predicted effect.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ControlProposal {
    pub run: RunId,
    /// Start of the run; for a combination, of the oldest run.
    pub measured_at: Timestamp,
    pub machine: String,
    /// Kind of the values, as a key of `[compensation]`.
    pub target: &'static str,
    /// Description of the control to which the values belong.
    pub control: String,
    pub estimate_sha256: String,
    #[serde(flatten)]
    pub proposal: Proposal,
    /// Length of the stylus: the positions hold for tools of this length, if the spindle is not parallel to Z.
    pub stylus_length_mm: f64,
    /// Errors of the axes that the values do not correct.
    pub remaining: Vec<RemainingAxisError>,
    /// Warnings of the estimate.
    pub warnings: Vec<String>,
    /// Sentences on the values for the person who approves them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// Prediction with the present values, and with the proposed values. Axis positions that the run does not determine
    /// count as correct. `None`: the run states no measured ranges, or the values do not determine the tool centre.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub predicted: Option<[PredictedToolError; 2]>,
}

impl ControlProposal {
    /// Hash by which a person approves the proposal.
    ///
    /// # Errors
    /// The proposal cannot be written as JSON.
    pub fn sha256(&self) -> Result<String, serde_json::Error> {
        sha256_of_json(self)
    }
}

/// Proposes values from the last estimate of `run`, for the control and the machine that `file` states.
///
/// # Errors
/// The run has no usable estimate, measured another machine, or did not record the present values of the
/// compensation files; no position is determined; a change is too large.
pub fn propose_for_control(
    journal: &Journal,
    run: RunId,
    file: &MachineFile,
    target: &dyn CompensationTarget,
    options: ProposalOptions,
) -> Result<ControlProposal, ControlProposalError> {
    let stored = journal.load_run(run)?;
    let last = last_usable_estimate(run, &stored)?;
    check_same_real_machine(run, &stored, file)?;
    let control = target.read()?;
    check_run_used_present_values(&stored, file)?;
    let mut measured_at = stored.summary.started;
    for combined in last.estimate.combined_runs() {
        let combined = journal.load_run(RunId(*combined))?;
        check_run_used_present_values(&combined, file)?;
        measured_at = measured_at.min(combined.summary.started);
    }
    let plan = &stored.plan;
    let stylus = stated_stylus_uncertainty(plan, &last.estimate, file);
    let measured = MeasuredAxisPositions::new(&plan.machine, stylus, &last.estimate)?;
    let proposal = propose(&measured, &control, options)?;
    Ok(ControlProposal {
        run,
        measured_at,
        machine: plan.machine.name.clone(),
        target: target.kind(),
        control: target.describe(),
        estimate_sha256: last.sha256.clone(),
        stylus_length_mm: plan.machine.tool_mm[2].abs(),
        remaining: remaining_errors(&last.estimate, |own| is_corrected(own, &proposal)),
        warnings: last.estimate.warnings.clone(),
        notes: target.notes(),
        predicted: match target.sets_tool_centre() {
            true => predict_before_and_after(&plan.machine, stylus, &last.estimate, &control, &proposal)?,
            false => None,
        },
        proposal,
    })
}

/// Uncertainty of the stylus: as `file` states it if the estimate contains coordinates of the stylus (`tool_…`);
/// otherwise as the run stated it, because it is then part of the estimate.
pub(super) fn stated_stylus_uncertainty(
    plan: &Plan,
    estimate: &Estimate,
    file: &MachineFile,
) -> StatedStylusUncertainty {
    match estimate.parameters.iter().any(|parameter| parameter.symbol.starts_with("tool_")) {
        true => StatedStylusUncertainty::new(&file.probe, &file.assumed_keys),
        false => StatedStylusUncertainty::new(&plan.probe, &plan.assumed),
    }
}

/// # Errors
/// The run has no estimate, or its readings contradict the model.
pub(super) fn last_usable_estimate(run: RunId, stored: &StoredRun) -> Result<&StoredEstimate, ControlProposalError> {
    let last = stored.estimates.last().ok_or(ControlProposalError::NoEstimate(run))?;
    check_model_is_not_contradicted(run, &last.estimate)?;
    Ok(last)
}

pub(super) fn check_model_is_not_contradicted(run: RunId, estimate: &Estimate) -> Result<(), ControlProposalError> {
    match estimate.verdict {
        Verdict::UndecidedModel => Err(ControlProposalError::ContradictedModel(run)),
        _ => Ok(()),
    }
}

/// Checks that the control used its present compensation values during the run, if the readings contain their effect.
pub(super) fn check_run_used_present_values(
    stored: &StoredRun,
    file: &MachineFile,
) -> Result<(), ControlProposalError> {
    for config in file.compensation.iter().filter(|config| config.is_in_readings()) {
        let control = open_target(file, Some(config.kind()))?.read()?;
        if !records_same_values(stored, config.kind(), control.values()) {
            return Err(ControlProposalError::CompensationValuesMismatch {
                run: stored.summary.id,
                kind: config.kind(),
            });
        }
    }
    Ok(())
}

/// Checks that the run measured the machine of `file` with its real control, and that topology, tool, stylus, active
/// compensations, and point, direction and positive sense of each axis are the same. Other data of the axes may differ.
pub(super) fn check_same_real_machine(
    run: RunId,
    stored: &StoredRun,
    file: &MachineFile,
) -> Result<(), ControlProposalError> {
    let (measured, stated) = (&stored.plan.machine, &file.machine);
    if measured.name != stated.name {
        let (measured, stated) = (measured.name.clone(), stated.name.clone());
        return Err(ControlProposalError::OtherMachine { run, measured, stated });
    }
    let of_run = MachineFile::from_stored_run("machine file", stored.machine_file_text.clone(), &stored.plan.artefact);
    let of_run = of_run.map_err(|error| ControlProposalError::UnreadableMachineFile { run, error: Box::new(error) })?;
    if matches!(of_run.controller_section.control, ControlConfig::Simulated(_)) {
        return Err(ControlProposalError::Simulated(run));
    }
    let axes = |machine: &Machine| -> Vec<_> {
        let stated = machine.axes.iter();
        stated.map(|(axis, stated)| (*axis, stated.positive, stated.point_mm, stated.direction)).collect()
    };
    let is_same = measured.topology == stated.topology
        && measured.tool_mm == stated.tool_mm
        && axes(measured) == axes(stated)
        && stored.plan.probe.stylus == file.probe.stylus
        && stored.plan.compensations_active == file.controller_section.compensations_active;
    if is_same { Ok(()) } else { Err(ControlProposalError::ChangedMachine(run)) }
}

/// Predicted errors before and after the correction. `None`: the estimate states no measured ranges, or the proposal
/// contains no positions of rotary axes.
fn predict_before_and_after(
    machine: &Machine,
    stylus: StatedStylusUncertainty,
    estimate: &Estimate,
    control: &ControlModel,
    proposal: &Proposal,
) -> Result<Option<[PredictedToolError; 2]>, MethodRefusal> {
    if estimate.measured_ranges.is_empty() || proposal.positions.is_empty() {
        return Ok(None);
    }
    let chain = KinematicChain::new(machine)?;
    let predict = |values_mm: &[f64]| -> Result<PredictedToolError, MethodRefusal> {
        let errors =
            control.compensated_errors(&chain, values_mm, proposal.at_mm, |own| proposal.is_determined(own))?;
        let predictor =
            ErrorPredictor::new(machine, stylus, estimate, WorkZero::TableOrigin)?.with_compensated_errors(errors);
        let poses = predictor.volume_grid_poses()?;
        let [relative_to_work_zero, _] = predictor.volume_errors(&poses, &predictor.tip_errors(&poses));
        Ok(PredictedToolError {
            largest_um: relative_to_work_zero.largest_mm * 1e3,
            expanded_largest_um: relative_to_work_zero.u_largest_mm * 2e3,
        })
    };
    let [mut before, mut after] = [Vec::new(), Vec::new()];
    for value in &proposal.values {
        before.push(value.present_mm);
        after.push(value.proposed_mm);
    }
    Ok(Some([predict(&before)?, predict(&after)?]))
}

/// Errors of the axes that are not corrected.
pub(super) fn remaining_errors(
    estimate: &Estimate,
    is_corrected: impl Fn(&Parameter) -> bool,
) -> Vec<RemainingAxisError> {
    let is_error = |own: &&Parameter| own.identifiable && own.symbol.parse::<ErrorParameter>().is_ok();
    let remaining = estimate.parameters.iter().filter(is_error).filter(|own| !is_corrected(own));
    let remaining = remaining.map(|own| RemainingAxisError {
        symbol: own.symbol.clone(),
        value: own.value,
        expanded: own.expanded,
        unit: own.unit,
    });
    remaining.collect()
}

/// Whether the proposal has a position or travel for this error, also if the present value is kept. Linear errors of
/// the spindle count as corrected by positions.
fn is_corrected(own: &Parameter, proposal: &Proposal) -> bool {
    let is_scale = |travel: &ProposedTravel| own.symbol == format!("E{0}{0}1", travel.travel.axis);
    let is_position = |position: &ProposedPosition| {
        let RotaryAxisCoordinate { axis, component } = position.coordinate;
        own.symbol == format!("E{component}0{axis}")
    };
    // The positions are relative to the axis of the spindle.
    let is_of_spindle = own.unit == Unit::Um
        && own.symbol.parse::<ErrorParameter>().is_ok_and(|error| error.axis() == Axis::S)
        && !proposal.positions.is_empty();
    is_of_spindle || proposal.positions.iter().any(is_position) || proposal.travels.iter().any(is_scale)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// A work offset moves C and, with it, the tilting axis B: X of B stays as it is.
    #[test]
    fn errors_without_a_value_of_the_control_are_not_corrected() {
        let position = ProposedPosition {
            coordinate: RotaryAxisCoordinate { axis: Axis::C, component: Axis::X },
            present_mm: 0.0,
            measured_mm: Some(0.05),
            expanded_mm: Some(0.001),
            proposed_mm: 0.05,
            kept: None,
        };
        let proposal = Proposal { positions: vec![position], travels: Vec::new(), values: Vec::new(), at_mm: None };
        let is_corrected = |symbol: &str, unit: &str| {
            let parameter = json!({"symbol": symbol, "value": 50.0, "unit": unit, "u": 0.5, "U": 1.0, "k": 2.0,
                "dof": null, "identifiable": true});
            is_corrected(&serde_json::from_value(parameter).unwrap(), &proposal)
        };
        assert!(is_corrected("EX0C", "um") && is_corrected("EX0S", "um"));
        for (symbol, unit) in [("EX0B", "um"), ("EY0C", "um"), ("EA0C", "urad"), ("EXX1", "um/m")] {
            assert!(!is_corrected(symbol, unit), "{symbol}");
        }
    }
}
