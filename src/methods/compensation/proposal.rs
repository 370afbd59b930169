//! The proposal: new values for a control, and why.

use serde::Serialize;

use super::axis_positions::{MeasuredAxisPositions, MeasuredLength, RotaryAxisCoordinate};
use super::control_model::ControlModel;
use super::travel::AxisTravel;
use crate::MethodRefusal;

/// Options of a proposal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProposalOptions {
    /// Whether positions whose deviation is within U are changed too.
    pub applies_insignificant_changes: bool,
    /// Largest change of a position or of the correction of a travel, mm; if one exceeds it, nothing is proposed.
    pub max_change_mm: f64,
}

impl ProposalOptions {
    pub const DEFAULT_MAX_CHANGE_MM: f64 = 0.5;
}

/// One position of a rotary axis, mm: present in the control, measured and proposed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProposedPosition {
    #[serde(flatten)]
    pub coordinate: RotaryAxisCoordinate,
    pub present_mm: f64,
    /// Absent: the run does not determine the position.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measured_mm: Option<f64>,
    /// Expanded uncertainty of the measured position.
    #[serde(rename = "U_mm", skip_serializing_if = "Option::is_none")]
    pub expanded_mm: Option<f64>,
    /// The measured position, or the present one if it is kept.
    pub proposed_mm: f64,
    /// Reason to keep the present position, with a remedy. Absent: the position is changed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kept: Option<MethodRefusal>,
}

/// The correction of the travel of a linear axis, mm: present in the control, required by the measurement, and
/// proposed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProposedTravel {
    #[serde(flatten)]
    pub travel: AxisTravel,
    /// Present correction: excess of the travel over the commanded travel that the table of the control causes.
    pub present_mm: f64,
    /// Present correction minus measured error. Absent: the run does not determine the error.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub required_mm: Option<f64>,
    /// Expanded uncertainty of the measured error.
    #[serde(rename = "U_mm", skip_serializing_if = "Option::is_none")]
    pub expanded_mm: Option<f64>,
    /// The required correction, or the present one if it is kept.
    pub proposed_mm: f64,
    /// Reason to keep the present correction, with a remedy. Absent: the correction is changed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kept: Option<MethodRefusal>,
}

/// One value of the control, mm.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProposedValue {
    pub name: String,
    pub present_mm: f64,
    /// The present value as the control states it.
    pub present_text: String,
    /// Rounded to the steps of the control; the present value if it is within half a step.
    pub proposed_mm: f64,
}

/// Proposed positions and corrections, and the values of the control for them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Proposal {
    /// All positions that the control computes, also those that are kept.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub positions: Vec<ProposedPosition>,
    /// All travels that the control corrects, also those whose correction is kept.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub travels: Vec<ProposedTravel>,
    /// All values of the control, also unchanged ones, in the order of the control model.
    pub values: Vec<ProposedValue>,
    /// Point for which the positions are valid: machine frame with all axes at zero, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at_mm: Option<[f64; 3]>,
}

impl Proposal {
    /// Whether the run determines the position.
    pub fn is_determined(&self, coordinate: RotaryAxisCoordinate) -> bool {
        self.positions.iter().any(|position| position.coordinate == coordinate && position.measured_mm.is_some())
    }
}

/// Proposes the measured positions and corrections, and the values of the control for them. A position or correction
/// that the run does not determine, or that deviates by at most U (unless `options` apply insignificant changes), is
/// kept; its value may still change to keep it.
///
/// # Errors
/// A change is larger than allowed; the run determines nothing that the control corrects.
pub fn propose(
    measured: &MeasuredAxisPositions<'_>,
    control: &ControlModel,
    options: ProposalOptions,
) -> Result<Proposal, MethodRefusal> {
    let present_mm = control.present_mm();
    let positions = control.positions.iter().zip(control.positions_mm(&present_mm));
    let positions = positions
        .map(|(position, present_mm)| propose_position(measured, position.coordinate, present_mm, options))
        .collect::<Result<Vec<_>, _>>()?;
    let travels = control.travels.iter();
    let travels = travels
        .map(|own| propose_travel(measured, own.travel, own.correction_mm(&present_mm), options))
        .collect::<Result<Vec<_>, _>>()?;
    check_something_is_determined(&positions, &travels)?;
    let positions_mm: Vec<f64> = positions.iter().map(|position| position.proposed_mm).collect();
    let corrections_mm: Vec<f64> = travels.iter().map(|travel| travel.proposed_mm).collect();
    let values = control.values().iter().zip(control.values_mm(&positions_mm, &corrections_mm));
    let values = values.map(|(value, proposed_mm)| ProposedValue {
        name: value.name.clone(),
        present_mm: value.present_mm,
        present_text: value.text.clone(),
        proposed_mm,
    });
    Ok(Proposal { values: values.collect(), positions, travels, at_mm: measured.at_mm() })
}

/// Refuses if the run determines no position and no travel, for the first of the reasons in `kept`.
fn check_something_is_determined(
    positions: &[ProposedPosition],
    travels: &[ProposedTravel],
) -> Result<(), MethodRefusal> {
    let is_determined = positions.iter().any(|position| position.measured_mm.is_some())
        || travels.iter().any(|travel| travel.required_mm.is_some());
    let reasons = positions.iter().map(|position| &position.kept).chain(travels.iter().map(|travel| &travel.kept));
    match reasons.flatten().next() {
        Some(refusal) if !is_determined => Err(refusal.clone()),
        _ => Ok(()),
    }
}

fn propose_position(
    measured: &MeasuredAxisPositions<'_>,
    coordinate: RotaryAxisCoordinate,
    present_mm: f64,
    options: ProposalOptions,
) -> Result<ProposedPosition, MethodRefusal> {
    let unchanged = ProposedPosition {
        coordinate,
        present_mm,
        measured_mm: None,
        expanded_mm: None,
        proposed_mm: present_mm,
        kept: None,
    };
    let MeasuredLength { mm, expanded_mm } = match measured.position(coordinate) {
        Ok(position) => position,
        Err(refusal) => return Ok(ProposedPosition { kept: Some(refusal), ..unchanged }),
    };
    let RotaryAxisCoordinate { axis, component } = coordinate;
    let kept = reason_to_keep(mm - present_mm, expanded_mm, options, &format!("{axis} in {component}"))?;
    let proposed_mm = if kept.is_some() { present_mm } else { mm };
    Ok(ProposedPosition { measured_mm: Some(mm), expanded_mm: Some(expanded_mm), proposed_mm, kept, ..unchanged })
}

fn propose_travel(
    measured: &MeasuredAxisPositions<'_>,
    travel: AxisTravel,
    present_mm: f64,
    options: ProposalOptions,
) -> Result<ProposedTravel, MethodRefusal> {
    let unchanged = ProposedTravel {
        travel,
        present_mm,
        required_mm: None,
        expanded_mm: None,
        proposed_mm: present_mm,
        kept: None,
    };
    let error = match measured.travel_error(travel) {
        Ok(error) => error,
        Err(refusal) => return Ok(ProposedTravel { kept: Some(refusal), ..unchanged }),
    };
    // The error was measured with the present correction active.
    let required_mm = present_mm - error.mm;
    let kept = reason_to_keep(-error.mm, error.expanded_mm, options, &format!("the travel of {}", travel.axis))?;
    Ok(ProposedTravel {
        required_mm: Some(required_mm),
        expanded_mm: Some(error.expanded_mm),
        proposed_mm: if kept.is_some() { present_mm } else { required_mm },
        kept,
        ..unchanged
    })
}

/// `None`: the change by `deviation_mm` is significant, or the options allow insignificant changes.
///
/// # Errors
/// The change would be made, but is larger than allowed.
fn reason_to_keep(
    deviation_mm: f64,
    expanded_mm: f64,
    options: ProposalOptions,
    what: &str,
) -> Result<Option<MethodRefusal>, MethodRefusal> {
    let is_changed = deviation_mm.abs() > expanded_mm || options.applies_insignificant_changes;
    MethodRefusal::require(
        !is_changed || deviation_mm.abs() <= options.max_change_mm,
        format!(
            "the change of {what} by {deviation_mm:.4} mm is larger than {:.4} mm, the largest allowed change",
            options.max_change_mm
        ),
        "check point_mm of the axis in the machine file and the value in the control; if both are right, allow the change \
         with --max-change-mm",
    )?;
    Ok((!is_changed).then(|| {
        let [deviation_um, expanded_um] = [deviation_mm, expanded_mm].map(|mm| mm * 1e3);
        MethodRefusal::new(
            format!("the deviation of {deviation_um:.1} µm is within U = {expanded_um:.1} µm"),
            "nothing needs to be changed",
        )
    }))
}
