//! Verification of a compensation by a second run, which measured with the new values.

use std::f64::consts::TAU;

use machine::{Axis, Position};
use methods::MethodRefusal;
use methods::compensation::{ControlModel, ControlValue, RemainingDeviation, compare_remaining_deviations};
use serde::Serialize;

use super::measured_run::{JointCoverage, MeasuredRun};
use super::proposal::{
    ControlProposalError, check_model_is_not_contradicted, check_run_used_present_values, check_same_real_machine,
    last_usable_estimate,
};
use super::target::{CompensationTarget, TargetError, last_compensation, values_before_or_after};
use super::targets::needs_control_link;
use super::tool_centre_comparison::{ToolCentreError, tool_centre_errors};
use super::values_record::records_same_values;
use crate::setup::MachineFile;
use crate::store::{CompensationState, Journal, RunId, StoreError, StoredCompensation, StoredRun};
use devices::compensation::are_values_equal;

/// Difference of two rotary positions, rad, from which they are other ones: 1°.
const MIN_POSITION_DIFFERENCE_RAD: f64 = 0.017_453_292_519_943_295;
/// Minimum number of rotary positions at which only the second run measured; checked if the values contain positions
/// of rotary axes.
const MIN_NEW_POSITIONS: usize = 3;

#[derive(Debug, thiserror::Error)]
pub enum VerificationError {
    #[error(transparent)]
    Journal(#[from] StoreError),
    #[error(transparent)]
    Target(#[from] TargetError),
    #[error(transparent)]
    Run(#[from] ControlProposalError),
    #[error(transparent)]
    Method(#[from] MethodRefusal),
    /// Name of the machine. No compensation is written, or the last compensation is undone or unfinished.
    #[error("no compensation of `{0}` is written")]
    NotWritten(String),
    /// `id`: number of the compensation.
    #[error("run {run} cannot verify compensation {id}: only run {earliest} or a later run can")]
    OlderRun { id: i64, run: RunId, earliest: RunId },
    /// `id`: number of the compensation.
    #[error("{name} of the control is {present_mm} mm; compensation {id} wrote {expected_mm} mm")]
    OtherValue { id: i64, name: String, present_mm: f64, expected_mm: f64 },
    /// `id`: number of the compensation. Where runs do not record the values, the run started before the
    /// compensation.
    #[error("the record of run {run} does not say that the control held the values of compensation {id}")]
    OtherValuesInRun { id: i64, run: RunId },
    /// `count`: rotary positions at which only `run` measured.
    #[error(
        "run {run} measured at only {count} rotary positions at which run {first} did not measure; {MIN_NEW_POSITIONS} are needed"
    )]
    SamePositions { run: RunId, first: RunId, count: usize },
}

impl VerificationError {
    /// What to do next.
    pub fn remedy(&self) -> String {
        let text = match self {
            Self::Journal(error) => error.remedy(),
            Self::Target(error) => return error.remedy(),
            Self::Run(error) => return error.remedy(),
            Self::Method(refusal) => return refusal.remedy.clone(),
            Self::NotWritten(_) => "list the last compensation with `trued compensate status`",
            Self::OlderRun { .. } | Self::OtherValuesInRun { .. } => "measure again now, and verify with the new run",
            Self::OtherValue { .. } => {
                "restore the values with `trued compensate undo`, or set this value at the control, then measure again"
            }
            Self::SamePositions { .. } => {
                "measure at other positions, e.g. with other tilt_deg and turn_deg in [method.samba], and verify with this \
                 run"
            }
        };
        text.to_owned()
    }
}

/// The result of a verification.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verification {
    /// Number of the verified compensation.
    pub compensation: i64,
    /// Run from which the compensation was computed.
    pub first_run: RunId,
    /// Run that measured with the new values.
    pub run: RunId,
    /// Rotary positions at which only the second run measured.
    pub new_position_count: usize,
    /// Remaining errors of the positions and travels that both runs determine, measured and predicted.
    pub deviations: Vec<RemainingDeviation>,
    /// Empty: the run has not read the tool centre of the control. `None`: these values do not determine it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tool_centres: Option<Vec<ToolCentreError>>,
}

impl Verification {
    /// Whether all differences from the prediction and all predicted errors are within their limits, and the
    /// control computes its tool centre from its values.
    pub fn is_confirmed(&self) -> bool {
        let mut tool_centres = self.tool_centres.iter().flatten();
        self.deviations.iter().all(RemainingDeviation::is_within_limits)
            && tool_centres.all(|own| own.follows_from_values() && own.is_as_predicted())
    }

    /// The state of the compensation by this result.
    pub fn state(&self) -> CompensationState {
        if self.is_confirmed() { CompensationState::Verified } else { CompensationState::NotConfirmed }
    }
}

/// Verifies the last compensation of these values of the machine by `run`.
///
/// # Errors
/// The last compensation is missing, undone or unfinished; the control, or the run, had other values; the run is
/// older, measured at the same positions, has no usable estimate, or does not determine a changed value; the
/// machine or its machine file has changed.
pub fn verify_by_run(
    journal: &Journal,
    run: RunId,
    file: &MachineFile,
    target: &dyn CompensationTarget,
) -> Result<Verification, VerificationError> {
    let last = last_compensation(journal, &file.machine.name, target)?;
    let not_written = || VerificationError::NotWritten(file.machine.name.clone());
    let last = last.filter(|last| !last.state.is_undone() && !last.state.forbids_motion()).ok_or_else(not_written)?;
    if !last.can_be_verified_by(run) {
        let earliest = last.verified_by.unwrap_or(RunId(last.run.0 + 1));
        return Err(VerificationError::OlderRun { id: last.id, run, earliest });
    }
    let [first, second] = [journal.load_run(last.run)?, journal.load_run(run)?];
    check_same_real_machine(last.run, &first, file)?;
    check_same_real_machine(run, &second, file)?;
    let control = target.read()?;
    check_values(&last, &second, file, &control)?;
    if !control.is_in_readings() {
        check_run_used_present_values(&first, file)?;
        check_run_used_present_values(&second, file)?;
    }
    let new_position_count = new_rotary_positions(journal, &first, &second)?;
    if control.has_positions() && new_position_count < MIN_NEW_POSITIONS {
        return Err(VerificationError::SamePositions { run, first: last.run, count: new_position_count });
    }
    let first = MeasuredRun::new(&first, &last_usable_estimate(last.run, &first)?.estimate, file);
    let own_estimate = second.own_estimate().ok_or(ControlProposalError::NoEstimate(run))?;
    check_model_is_not_contradicted(run, own_estimate)?;
    let second = MeasuredRun::new(&second, own_estimate, file);
    let sets_tool_centre = target.sets_tool_centre();
    let coverage = JointCoverage::new([&first, &second], &control, sets_tool_centre);
    Ok(Verification {
        compensation: last.id,
        first_run: last.run,
        run,
        new_position_count,
        deviations: remaining_deviations([&first, &second], &control, &last, coverage)?,
        tool_centres: match sets_tool_centre {
            true => Some(tool_centre_errors([&first, &second], &control, coverage)?),
            false => None,
        },
    })
}

/// Checks that the control holds the values of the compensation, and held them during the run: by its record, or,
/// where a run does not record them, by the time of its start.
fn check_values(
    last: &StoredCompensation,
    stored: &StoredRun,
    file: &MachineFile,
    control: &ControlModel,
) -> Result<(), VerificationError> {
    for (name, expected_mm) in values_before_or_after(&last.changes, true) {
        let present = control.values().iter().find(|value| value.name == name);
        let present_mm = present.map_or(f64::NAN, |value| value.present_mm);
        if !are_values_equal(present_mm, expected_mm) {
            return Err(VerificationError::OtherValue { id: last.id, name, present_mm, expected_mm });
        }
    }
    let had_values = match needs_control_link(file, Some(&last.target)) {
        true => last.verified_by.is_some() || stored.summary.started > last.at,
        false => records_same_values(stored, &last.target, control.values()),
    };
    match had_values {
        true => Ok(()),
        false => Err(VerificationError::OtherValuesInRun { id: last.id, run: stored.summary.id }),
    }
}

/// Number of rotary positions, with the orientation of the spindle, at which only the second run measured. A
/// combination measured where its runs did.
fn new_rotary_positions(journal: &Journal, first: &StoredRun, second: &StoredRun) -> Result<usize, StoreError> {
    let mut known = Vec::new();
    add_rotary_positions(first, &mut known);
    for combined in first.estimates.last().into_iter().flat_map(|last| last.estimate.combined_runs()) {
        add_rotary_positions(&journal.load_run(RunId(*combined))?, &mut known);
    }
    let known_count = known.len();
    add_rotary_positions(second, &mut known);
    Ok(known.len() - known_count)
}

/// Adds the rotary positions of the readings that differ from all in `found`.
fn add_rotary_positions(stored: &StoredRun, found: &mut Vec<Position>) {
    for reading in &stored.readings {
        let at = reading.position.filter_axes(|axis| !axis.is_linear());
        let is_same = |other: &Position| {
            let difference = |(axis, value): (Axis, f64)| value - other.get_or_zero(axis);
            at.iter().all(|own| {
                (difference(own) - (difference(own) / TAU).round() * TAU).abs() < MIN_POSITION_DIFFERENCE_RAD
            })
        };
        if !found.iter().any(is_same) {
            found.push(at);
        }
    }
}

/// Deviations of all quantities that both runs determine; an error if a run does not determine a changed quantity.
fn remaining_deviations(
    [first, second]: [&MeasuredRun<'_>; 2],
    control: &ControlModel,
    last: &StoredCompensation,
    coverage: JointCoverage,
) -> Result<Vec<RemainingDeviation>, VerificationError> {
    let before = values_before_or_after(&last.changes, false);
    let before_of = |value: &ControlValue| {
        before.iter().find(|(name, _)| *name == value.name).map_or(value.present_mm, |(_, mm)| *mm)
    };
    let before_mm: Vec<f64> = control.values().iter().map(before_of).collect();
    let (first, second) = (first.positions()?, second.positions()?);
    Ok(compare_remaining_deviations(first, second, control, &before_mm, coverage.ratio())?)
}
