//! The proposal of new values for a control from a stored run.

use serde::Serialize;

use crate::store::{Journal, RunId, StoreError, sha256};
use machine::kinematics::{ErrorParameter, ErrorShape, ErrorTerm};
use machine::record::estimate::{Estimate, Unit, Verdict};
use machine::record::machine::Machine;
use methods::MethodRefusal;
use methods::compensation::{
    MeasuredAxisPositions, Proposal, ProposalOptions, TargetValue, location_errors_of_control, propose,
};
use methods::prediction::{ErrorPredictor, WorkZero};

#[derive(Debug, thiserror::Error)]
pub enum ControlProposalError {
    #[error(transparent)]
    Journal(#[from] StoreError),
    #[error(transparent)]
    Method(#[from] MethodRefusal),
    #[error("run {0} has no estimate")]
    NoEstimate(RunId),
    #[error("the readings of run {0} contradict the model: no uncertainty is reliable, and nothing is proposed")]
    ContradictedModel(RunId),
    #[error("run {run} measured the machine `{measured}`; the machine file is of `{stated}`")]
    OtherMachine { run: RunId, measured: String, stated: String },
    #[error("the machine file states the axes otherwise than run {0} measured them")]
    ChangedMachine(RunId),
    #[error(transparent)]
    Json(#[from] serde_json::Error),
}

impl ControlProposalError {
    /// What to do next.
    pub fn remedy(&self) -> String {
        match self {
            Self::Journal(error) => error.remedy().to_owned(),
            Self::Method(refusal) => refusal.remedy.clone(),
            Self::NoEstimate(run) => {
                format!("identify the run with `trued identify --run {run}`, or choose another run")
            }
            Self::ContradictedModel(run) => {
                format!("read the warnings with `trued show {run}`, remove the cause, and measure again")
            }
            Self::OtherMachine { .. } => "give the machine file of this machine with --machine".to_owned(),
            Self::ChangedMachine(_) => "measure again with this machine file".to_owned(),
            Self::Json(_) => "report this error".to_owned(),
        }
    }
}

/// An error of the axes that the values of the control cannot correct, in its unit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UncorrectedError {
    pub symbol: String,
    pub value: f64,
    #[serde(rename = "U")]
    pub expanded: f64,
    pub unit: Unit,
}

/// Largest position error of the tool relative to the work zero over the measured ranges, with tool centre point
/// control, µm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PredictedError {
    pub largest_um: f64,
    /// Upper bound of the largest error with a probability of 95.45 %.
    pub bound_um: f64,
}

/// New values for a control, with their effect.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ControlProposal {
    pub run: RunId,
    pub machine: String,
    pub estimate_sha256: String,
    #[serde(flatten)]
    pub proposal: Proposal,
    pub not_corrected: Vec<UncorrectedError>,
    /// With the present values, and with the proposed ones. Absent: the run states no measured ranges.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub predicted: Option<[PredictedError; 2]>,
}

/// Proposes values from the last estimate of `run`. `machine`: as the machine file states it now.
///
/// # Errors
/// The run has no usable estimate, or measured another machine; no value is determined; a change is too large.
pub fn propose_for_control(
    journal: &Journal,
    run: RunId,
    machine: &Machine,
    values: &[TargetValue],
    options: ProposalOptions,
) -> Result<ControlProposal, ControlProposalError> {
    let stored = journal.load_run(run)?;
    let estimate = &stored.estimates.last().ok_or(ControlProposalError::NoEstimate(run))?.estimate;
    check_machine(run, &stored.plan.machine, machine)?;
    if estimate.verdict == Verdict::UndecidedModel {
        return Err(ControlProposalError::ContradictedModel(run));
    }
    let measured = MeasuredAxisPositions::new(machine, stored.plan.probe.stylus_offset_um * 1e-3, estimate)?;
    let proposal = propose(&measured, values, options)?;
    let present_mm: Vec<f64> = values.iter().map(|value| value.present_mm).collect();
    let control_errors = [present_mm, proposal.proposed_mm()]
        .map(|values_mm| location_errors_of_control(machine, values, &values_mm))
        .into_iter()
        .collect::<Result<Vec<_>, _>>()?;
    let predicted = control_errors
        .iter()
        .map(|errors| predict_largest_error(machine, estimate, errors))
        .collect::<Result<Option<Vec<_>>, _>>()?;
    Ok(ControlProposal {
        run,
        machine: machine.name.clone(),
        estimate_sha256: sha256(estimate)?,
        not_corrected: uncorrected_errors(estimate, values),
        predicted: predicted.and_then(|both| both.try_into().ok()),
        proposal,
    })
}

/// Checks that the axes are where the run assumed them.
fn check_machine(run: RunId, measured: &Machine, stated: &Machine) -> Result<(), ControlProposalError> {
    if measured.name != stated.name {
        let (measured, stated) = (measured.name.clone(), stated.name.clone());
        return Err(ControlProposalError::OtherMachine { run, measured, stated });
    }
    let positions = |machine: &Machine| -> Vec<_> {
        let of_axis =
            machine.axes.iter().map(|(axis, stated)| (*axis, stated.positive, stated.point_mm, stated.direction));
        of_axis.collect()
    };
    let is_same = measured.topology == stated.topology
        && measured.tool_mm == stated.tool_mm
        && positions(measured) == positions(stated);
    if is_same { Ok(()) } else { Err(ControlProposalError::ChangedMachine(run)) }
}

/// `None`: the estimate states no measured ranges.
fn predict_largest_error(
    machine: &Machine,
    estimate: &Estimate,
    control_errors: &[ErrorTerm],
) -> Result<Option<PredictedError>, MethodRefusal> {
    if estimate.measured.is_empty() {
        return Ok(None);
    }
    let predictor = ErrorPredictor::new(machine, estimate, WorkZero::TableOrigin)?;
    let predictor = predictor.with_compensated_errors(control_errors.to_vec());
    let poses = predictor.volume_grid_poses()?;
    let [relative_to_work_zero, _] = predictor.volume_errors(&poses, &predictor.tip_errors(&poses));
    Ok(Some(PredictedError {
        largest_um: relative_to_work_zero.largest_mm * 1e3,
        bound_um: relative_to_work_zero.largest_95_percent_bound_mm * 1e3,
    }))
}

/// Errors of the axes, except those positions of which `values` are sums and those of the spindle, which are relative to
/// them.
fn uncorrected_errors(estimate: &Estimate, values: &[TargetValue]) -> Vec<UncorrectedError> {
    let is_corrected = |error: ErrorParameter| {
        let is_own = |component, axis| error.component() == component && error.axis() == axis;
        let mut coordinates = values.iter().flat_map(|value| &value.terms).map(|(coordinate, _)| coordinate);
        let is_position = error.shape() == ErrorShape::Location && error.component().is_linear();
        is_position && (error.axis() == machine::Axis::S || coordinates.any(|own| is_own(own.component, own.axis)))
    };
    let of_axes = estimate.parameters.iter().filter(|own| own.symbol.parse().is_ok_and(|error| !is_corrected(error)));
    of_axes
        .map(|own| UncorrectedError {
            symbol: own.symbol.clone(),
            value: own.value,
            expanded: own.expanded,
            unit: own.unit,
        })
        .collect()
}
