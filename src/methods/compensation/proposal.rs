//! The proposal: new values for a control, and why.

use serde::{Deserialize, Serialize};

use super::axis_positions::{MeasuredAxisPositions, ValueWithUncertainty};
use super::target_value::{TargetValue, ValueEffect};
use crate::MethodRefusal;

/// What a person may choose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProposalOptions {
    /// Also changes values whose deviation is within U.
    pub with_insignificant_changes: bool,
    /// Largest change of a value, mm.
    pub max_change_mm: f64,
}

impl Default for ProposalOptions {
    fn default() -> Self {
        Self { with_insignificant_changes: false, max_change_mm: 0.5 }
    }
}

/// One value: what the control holds, what was measured, and what is proposed, mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ProposedValue {
    pub name: String,
    pub present_mm: f64,
    /// The measured value; absent if the run does not determine it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured_mm: Option<f64>,
    /// Expanded uncertainty of the measured value.
    #[serde(rename = "U_mm", default, skip_serializing_if = "Option::is_none")]
    pub expanded_mm: Option<f64>,
    pub proposed_mm: f64,
    /// Why the present value is kept; absent if it is changed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kept_because: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Proposal {
    pub values: Vec<ProposedValue>,
}

impl Proposal {
    pub fn has_changes(&self) -> bool {
        self.values.iter().any(|value| value.kept_because.is_none())
    }

    /// The proposed values in their order, mm.
    pub fn proposed_mm(&self) -> Vec<f64> {
        self.values.iter().map(|value| value.proposed_mm).collect()
    }
}

/// Proposes a value for each of `values`: the measured value, in steps of the resolution. A value that the run does not
/// determine, or that deviates by less than U, is kept.
///
/// # Errors
/// A change is larger than allowed; the run determines none of the values.
pub fn propose(
    measured: &MeasuredAxisPositions<'_>,
    values: &[TargetValue],
    options: ProposalOptions,
) -> Result<Proposal, MethodRefusal> {
    let mut refusals = Vec::new();
    let mut proposed = Vec::new();
    for value in values {
        match measured.sum(&value.terms) {
            Ok(sum) => proposed.push(propose_value(value, measured_value(measured, value, sum), options)?),
            Err(refusal) => {
                proposed.push(keep_value(value, None, refusal.reason.clone()));
                refusals.push(refusal);
            }
        }
    }
    match refusals.into_iter().next() {
        Some(first) if proposed.iter().all(|value| value.measured_mm.is_none()) => Err(first),
        _ => Ok(Proposal { values: proposed }),
    }
}

/// The value that the control should hold. Readings that contain the effect of the present value show what is missing
/// in it; other readings show the whole position.
fn measured_value(
    measured: &MeasuredAxisPositions<'_>,
    value: &TargetValue,
    sum: ValueWithUncertainty,
) -> ValueWithUncertainty {
    let mm = match value.effect {
        ValueEffect::NotInReadings => sum.mm - value.offset_mm,
        ValueEffect::InReadings => value.present_mm + sum.mm - measured.nominal_sum(&value.terms),
    };
    ValueWithUncertainty { mm, ..sum }
}

fn propose_value(
    value: &TargetValue,
    measured: ValueWithUncertainty,
    options: ProposalOptions,
) -> Result<ProposedValue, MethodRefusal> {
    let expanded_mm = measured.k * measured.u_mm;
    let deviation_mm = measured.mm - value.present_mm;
    let rounded_mm = (measured.mm / value.resolution_mm).round() * value.resolution_mm;
    let is_significant = deviation_mm.abs() > expanded_mm || options.with_insignificant_changes;
    if !is_significant {
        let reason = format!("the deviation of {:.1} µm is within U = {:.1} µm", deviation_mm * 1e3, expanded_mm * 1e3);
        return Ok(keep_value(value, Some(measured), reason));
    }
    if (rounded_mm - value.present_mm).abs() < value.resolution_mm / 2.0 {
        return Ok(keep_value(value, Some(measured), "the change is below the resolution of the control".to_owned()));
    }
    let change_mm = rounded_mm - value.present_mm;
    MethodRefusal::require(
        change_mm.abs() <= options.max_change_mm,
        format!(
            "the change of {} by {change_mm:.4} mm is larger than {:.4} mm, the largest allowed change",
            value.name, options.max_change_mm
        ),
        "check point_mm of the axis in the machine file and the value at the control; if both are right, allow the change \
         with --max-change-mm",
    )?;
    Ok(ProposedValue {
        name: value.name.clone(),
        present_mm: value.present_mm,
        measured_mm: Some(measured.mm),
        expanded_mm: Some(expanded_mm),
        proposed_mm: rounded_mm,
        kept_because: None,
    })
}

fn keep_value(value: &TargetValue, measured: Option<ValueWithUncertainty>, reason: String) -> ProposedValue {
    ProposedValue {
        name: value.name.clone(),
        present_mm: value.present_mm,
        measured_mm: measured.map(|own| own.mm),
        expanded_mm: measured.map(|own| own.k * own.u_mm),
        proposed_mm: value.present_mm,
        kept_because: Some(reason),
    }
}
