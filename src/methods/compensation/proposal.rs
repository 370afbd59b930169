//! The proposal: new values for a control, and why.

use serde::Serialize;

use super::axis_positions::{AxisCoordinate, MeasuredAxisPositions, MeasuredPosition};
use super::control_model::ControlModel;
use crate::MethodRefusal;

/// Options of a proposal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProposalOptions {
    /// Also changes positions of which the deviation is within U.
    pub with_insignificant_changes: bool,
    /// Largest change of a position, mm.
    pub max_change_mm: f64,
}

impl ProposalOptions {
    pub const DEFAULT_MAX_CHANGE_MM: f64 = 0.5;
}

/// One position of a rotary axis, mm: present in the control, measured and proposed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProposedPosition {
    #[serde(flatten)]
    pub coordinate: AxisCoordinate,
    pub present_mm: f64,
    /// Absent: the run does not determine the position.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measured_mm: Option<f64>,
    /// Expanded uncertainty of the measured position.
    #[serde(rename = "U_mm", skip_serializing_if = "Option::is_none")]
    pub expanded_mm: Option<f64>,
    pub proposed_mm: f64,
    /// Why the present position is kept, and what to do about it. Absent: it is changed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kept: Option<MethodRefusal>,
}

/// One value of the control, mm.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProposedValue {
    pub name: String,
    pub present_mm: f64,
    pub proposed_mm: f64,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Proposal {
    pub positions: Vec<ProposedPosition>,
    pub values: Vec<ProposedValue>,
    /// Point for which the positions are valid: machine frame with all axes at zero, mm.
    pub at_mm: [f64; 3],
}

impl Proposal {
    /// Whether the run determines the position.
    pub fn is_determined(&self, coordinate: AxisCoordinate) -> bool {
        self.positions.iter().any(|position| position.coordinate == coordinate && position.measured_mm.is_some())
    }
}

/// Proposes the measured positions, and the values of the control for them. A position that the run does not determine,
/// or that deviates by less than U, is kept: then a value may change so that the position does not.
///
/// # Errors
/// A change is larger than allowed; the run determines no position.
pub fn propose(
    measured: &MeasuredAxisPositions<'_>,
    control: &ControlModel,
    options: ProposalOptions,
) -> Result<Proposal, MethodRefusal> {
    let present_mm = control.positions_mm(&control.present_mm());
    let mut positions = Vec::new();
    for (position, present_mm) in control.positions.iter().zip(present_mm) {
        let coordinate = position.coordinate;
        positions.push(match measured.position(coordinate) {
            Ok(measured) => propose_position(coordinate, present_mm, measured, options)?,
            Err(refusal) => ProposedPosition {
                coordinate,
                present_mm,
                measured_mm: None,
                expanded_mm: None,
                proposed_mm: present_mm,
                kept: Some(refusal),
            },
        });
    }
    if positions.iter().all(|position| position.measured_mm.is_none())
        && let Some(refusal) = positions.iter_mut().find_map(|position| position.kept.take())
    {
        return Err(refusal);
    }
    let proposed_mm: Vec<f64> = positions.iter().map(|position| position.proposed_mm).collect();
    let values = control.values().iter().zip(control.values_mm(&proposed_mm)).map(|(value, proposed_mm)| {
        ProposedValue { name: value.name.clone(), present_mm: value.present_mm, proposed_mm }
    });
    Ok(Proposal { values: values.collect(), positions, at_mm: measured.at_mm() })
}

fn propose_position(
    coordinate: AxisCoordinate,
    present_mm: f64,
    measured: MeasuredPosition,
    options: ProposalOptions,
) -> Result<ProposedPosition, MethodRefusal> {
    let MeasuredPosition { mm, expanded_mm } = measured;
    let AxisCoordinate { axis, component } = coordinate;
    let deviation_mm = mm - present_mm;
    let is_changed = deviation_mm.abs() > expanded_mm || options.with_insignificant_changes;
    MethodRefusal::require(
        !is_changed || deviation_mm.abs() <= options.max_change_mm,
        format!(
            "the change of {axis} in {component} by {deviation_mm:.4} mm is larger than {:.4} mm, the largest allowed \
             change",
            options.max_change_mm
        ),
        "check point_mm of the axis in the machine file and the value in the control; if both are right, allow the change \
         with --max-change-mm",
    )?;
    let kept = (!is_changed).then(|| {
        let [deviation_um, expanded_um] = [deviation_mm, expanded_mm].map(|mm| mm * 1e3);
        MethodRefusal::new(
            format!("the deviation of {deviation_um:.1} µm is within U = {expanded_um:.1} µm"),
            "nothing needs to be changed",
        )
    });
    Ok(ProposedPosition {
        coordinate,
        present_mm,
        measured_mm: Some(mm),
        expanded_mm: Some(expanded_mm),
        proposed_mm: if is_changed { mm } else { present_mm },
        kept,
    })
}
