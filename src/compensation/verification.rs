//! Verification of a compensation by a second run, which measured with the new values.

use machine::frame::Point;
use machine::kinematics::{ErrorTerm, KinematicChain};
use machine::record::estimate::Estimate;
use machine::record::event::RunEvent;
use machine::record::tool_centre::ToolCentreReading;
use machine::{Axis, Position};
use methods::MethodRefusal;
use methods::compensation::{
    ControlModel, ControlValue, MeasuredAxisPositions, RemainingDeviation, RotaryAxisCoordinate,
    compare_remaining_deviations, joint_coverage_ratio,
};
use methods::identification::StatedStylusUncertainty;
use methods::prediction::{ErrorPredictor, WorkZero};
use nalgebra::Vector3;
use serde::Serialize;

use super::proposal::{ControlProposalError, check_same_real_machine, last_usable_estimate, stated_stylus_uncertainty};
use super::target::{CompensationTarget, TargetError, values_before_or_after};
use super::targets::needs_control_link;
use super::values_record::records_same_values;
use crate::setup::MachineFile;
use crate::store::{CompensationState, Journal, RunId, StoreError, StoredCompensation, StoredRun};
use devices::compensation::MAX_READ_BACK_DEVIATION_MM;

/// Difference of two rotary positions, rad, from which they are other ones: 1°.
const MIN_POSITION_DIFFERENCE_RAD: f64 = 0.017_453_292_519_943_295;
/// Minimum number of rotary positions at which only the second run measured.
const MIN_NEW_POSITIONS: usize = 3;
/// Largest deviation of the tool centre by the control from that of its values, mm: the control prints six decimals of
/// positions in mm and degrees.
const MAX_CONTROL_DEVIATION_MM: f64 = 1e-4;

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
    #[error("no compensation of `{0}` is written")]
    NotWritten(String),
    #[error("compensation {id} was made from run {run}: a run cannot verify itself")]
    SameRun { id: i64, run: RunId },
    #[error("{name} of the control is {present_mm} mm; compensation {id} wrote {expected_mm} mm")]
    OtherValue { id: i64, name: String, present_mm: f64, expected_mm: f64 },
    #[error("the record of run {run} does not say that the control held the values of compensation {id}")]
    OtherValuesInRun { id: i64, run: RunId },
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
            Self::SameRun { .. } | Self::OtherValuesInRun { .. } => "measure again now, and verify with the new run",
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

/// Error of the tool centre at one standstill of the second run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ToolCentreError {
    pub step: u32,
    pub position: Position,
    /// Tool centre by the control minus the one that follows from its values, mm.
    pub control_deviation_mm: f64,
    /// By the second run and the tool centre of the control, mm.
    pub measured_mm: [f64; 3],
    /// By the run of the compensation, mm.
    pub predicted_mm: [f64; 3],
    /// Limit of the difference of both, as [`RemainingDeviation::limit_mm`], mm.
    pub limit_mm: [f64; 3],
}

impl ToolCentreError {
    fn is_within_limits(&self) -> bool {
        let is_within = |k: usize| (self.measured_mm[k] - self.predicted_mm[k]).abs() <= self.limit_mm[k];
        self.control_deviation_mm <= MAX_CONTROL_DEVIATION_MM && (0..3).all(is_within)
    }
}

/// The result of a verification.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verification {
    pub compensation: i64,
    /// Run of the compensation.
    pub first_run: RunId,
    /// Run that measured with the new values.
    pub run: RunId,
    /// Rotary positions at which only the second run measured.
    pub new_position_count: usize,
    pub deviations: Vec<RemainingDeviation>,
    /// Empty: the run has no tool centres of the control.
    pub tool_centres: Vec<ToolCentreError>,
}

impl Verification {
    /// Whether all differences from the prediction are within their limits.
    pub fn is_confirmed(&self) -> bool {
        self.deviations.iter().all(RemainingDeviation::is_within_limit)
            && self.tool_centres.iter().all(ToolCentreError::is_within_limits)
    }

    /// The state of the compensation by this result.
    pub fn state(&self) -> CompensationState {
        if self.is_confirmed() { CompensationState::Verified } else { CompensationState::NotConfirmed }
    }
}

/// Verifies the last compensation of these values of the machine by `run`.
///
/// # Errors
/// None is written; the control, or the run, had other values; the run measured at the same positions, or has no usable
/// estimate.
pub fn verify_by_run(
    journal: &Journal,
    run: RunId,
    file: &MachineFile,
    target: &dyn CompensationTarget,
) -> Result<Verification, VerificationError> {
    let last = journal.last_compensation(&file.machine.name, target.kind())?;
    let not_written = || VerificationError::NotWritten(file.machine.name.clone());
    let last = last.filter(|last| !last.state.is_undone() && !last.state.forbids_motion()).ok_or_else(not_written)?;
    if run == last.run {
        return Err(VerificationError::SameRun { id: last.id, run });
    }
    let [first, second] = [journal.load_run(last.run)?, journal.load_run(run)?];
    check_same_real_machine(run, &second, file)?;
    let control = target.read()?;
    check_values(&last, &second, file, &control)?;
    let new_position_count = new_rotary_positions(&first, &second);
    if control.has_positions() && new_position_count < MIN_NEW_POSITIONS {
        return Err(VerificationError::SamePositions { run, first: last.run, count: new_position_count });
    }
    let runs = [MeasuredRun::new(&first, file)?, MeasuredRun::new(&second, file)?];
    let [first, second] = &runs;
    Ok(Verification {
        compensation: last.id,
        first_run: last.run,
        run,
        new_position_count,
        deviations: remaining_deviations([first, second], &control, &last)?,
        tool_centres: tool_centre_errors([first, second], &control)?,
    })
}

/// Checks that the control holds the values of the compensation, and held them during the run: by its record, or, where a
/// run does not record them, by the time of its start.
fn check_values(
    last: &StoredCompensation,
    stored: &StoredRun,
    file: &MachineFile,
    control: &ControlModel,
) -> Result<(), VerificationError> {
    for (name, expected_mm) in values_before_or_after(&last.changes, true) {
        let present = control.values().iter().find(|value| value.name == name);
        let present_mm = present.map_or(f64::NAN, |value| value.present_mm);
        let is_equal = (present_mm - expected_mm).abs() < MAX_READ_BACK_DEVIATION_MM;
        if !is_equal {
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

/// Number of rotary positions, with the orientation of the spindle, at which only the second run measured.
fn new_rotary_positions(first: &StoredRun, second: &StoredRun) -> usize {
    let mut known = rotary_positions(first, Vec::new());
    let known_count = known.len();
    known = rotary_positions(second, known);
    known.len() - known_count
}

/// `found`, and the rotary positions of the readings that differ from all of these.
fn rotary_positions(stored: &StoredRun, mut found: Vec<Position>) -> Vec<Position> {
    for reading in &stored.readings {
        let at = reading.position.filter_axes(|axis| !axis.is_linear());
        let is_same = |other: &Position| {
            let is_near =
                |(axis, value): (Axis, f64)| (value - other.get_or_zero(axis)).abs() < MIN_POSITION_DIFFERENCE_RAD;
            at.iter().all(is_near)
        };
        if !found.iter().any(is_same) {
            found.push(at);
        }
    }
    found
}

/// One of the two runs, with what its estimate determines.
struct MeasuredRun<'a> {
    stored: &'a StoredRun,
    estimate: &'a Estimate,
    stylus: StatedStylusUncertainty,
}

impl<'a> MeasuredRun<'a> {
    fn new(stored: &'a StoredRun, file: &MachineFile) -> Result<Self, VerificationError> {
        let estimate = &last_usable_estimate(stored.summary.id, stored)?.estimate;
        Ok(Self { stored, estimate, stylus: stated_stylus_uncertainty(&stored.plan, estimate, file) })
    }

    fn positions(&self) -> Result<MeasuredAxisPositions<'a>, MethodRefusal> {
        MeasuredAxisPositions::new(&self.stored.plan.machine, self.stylus, self.estimate)
    }

    fn predictor(&self, compensated: Vec<ErrorTerm>) -> Result<ErrorPredictor<'a>, MethodRefusal> {
        let predictor =
            ErrorPredictor::new(&self.stored.plan.machine, self.stylus, self.estimate, WorkZero::TableOrigin)?;
        Ok(predictor.with_compensated_errors(compensated))
    }
}

fn remaining_deviations(
    [first, second]: [&MeasuredRun<'_>; 2],
    control: &ControlModel,
    last: &StoredCompensation,
) -> Result<Vec<RemainingDeviation>, VerificationError> {
    let before = values_before_or_after(&last.changes, false);
    let before_of = |value: &ControlValue| {
        before.iter().find(|(name, _)| *name == value.name).map_or(value.present_mm, |(_, mm)| *mm)
    };
    let before_mm: Vec<f64> = control.values().iter().map(before_of).collect();
    Ok(compare_remaining_deviations(first.positions()?, second.positions()?, control, &before_mm)?)
}

/// Errors of the tool centre where the second run has read it from the control. They are relative to the tool centre at
/// the origin of the table, with the rotary axes at zero.
fn tool_centre_errors(
    [first, second]: [&MeasuredRun<'_>; 2],
    control: &ControlModel,
) -> Result<Vec<ToolCentreError>, VerificationError> {
    let readings = second.stored.events.iter().filter_map(|(_, event)| match event {
        RunEvent::ToolCentreRead { step, reading, .. } => Some((*step, reading)),
        _ => None,
    });
    let readings: Vec<(u32, &ToolCentreReading)> = readings.collect();
    let machine = &second.stored.plan.machine;
    let chain = KinematicChain::new(machine).map_err(MethodRefusal::from)?;
    // For the control a tool is on the axis of the spindle.
    let tool_centre = Point::from_vec(Vector3::z() * machine.tool_mm[2]);
    let (of_first, of_second) = (first.positions()?, second.positions()?);
    let values_mm: Vec<f64> = control.values().iter().map(|value| value.present_mm).collect();
    let errors_of_control = |is_determined: &dyn Fn(RotaryAxisCoordinate) -> bool| {
        control.compensated_errors(&chain, &values_mm, of_first.at_mm(), is_determined)
    };
    let all = errors_of_control(&|_| true)?;
    let determined = errors_of_control(&|own| of_first.position(own).is_ok() && of_second.position(own).is_ok())?;
    let predictors = [first.predictor(determined.clone())?, second.predictor(determined)?];
    let ratio = joint_coverage_ratio(3 * readings.len());
    let error = |(step, reading): (u32, &ToolCentreReading)| {
        let position = &reading.position;
        let tip = |at: &Position, errors: &[ErrorTerm]| chain.tip_in_table(at, tool_centre, errors).mm;
        // The coordinates of the control are those of the machine while the rotary axes are at zero.
        let at_zero = position.filter_axes(Axis::is_linear);
        let by_values = tip(position, &all) - (tip(&at_zero, &all) - tip(&at_zero, &[]));
        let deviation = by_values - Vector3::from(reading.tool_centre_mm);
        let [predicted, measured] = [0, 1].map(|k| predictors[k].pose_error(position));
        let u_mm = predicted.u_tip_error_mm.zip_map(&measured.u_tip_error_mm, f64::hypot);
        ToolCentreError {
            step,
            position: position.clone(),
            control_deviation_mm: deviation.norm(),
            measured_mm: (measured.tip_error_mm + deviation).into(),
            predicted_mm: predicted.tip_error_mm.into(),
            limit_mm: (u_mm * 2.0 * ratio).add_scalar(MAX_CONTROL_DEVIATION_MM).into(),
        }
    };
    Ok(readings.into_iter().map(error).collect())
}
