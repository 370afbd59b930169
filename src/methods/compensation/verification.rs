//! Verification: what a second run finds after a compensation, against what the first one predicts.

use estimation::coverage::{COVERAGE_PROBABILITY, two_sided_t_factor};
use serde::Serialize;

use super::axis_positions::{MeasuredAxisPositions, MeasuredLength, RotaryAxisCoordinate};
use super::control_model::ControlModel;
use super::travel::AxisTravel;
use crate::MethodRefusal;

/// Distance of two reference points, mm, from which positions that are stated at them cannot be compared.
const MAX_REFERENCE_DISTANCE_MM: f64 = 1e-6;

/// What a value of the control corrects.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(untagged)]
pub enum CorrectedQuantity {
    Position(RotaryAxisCoordinate),
    Travel(AxisTravel),
}

/// Error of a corrected quantity after the compensation, mm.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RemainingDeviation {
    #[serde(flatten)]
    pub quantity: CorrectedQuantity,
    /// By the run of the compensation.
    pub predicted_mm: f64,
    /// By the second run.
    pub measured_mm: f64,
    /// Limit of the difference of both: with correct values, all differences of a verification are below their limits
    /// with the probability 95.45 %.
    pub limit_mm: f64,
}

impl RemainingDeviation {
    pub fn is_within_limit(&self) -> bool {
        (self.measured_mm - self.predicted_mm).abs() <= self.limit_mm
    }
}

/// Factor of the expanded uncertainty with which `count` independent comparisons hold together with the probability
/// 95.45 % (Bonferroni).
pub fn joint_coverage_ratio(count: usize) -> f64 {
    let each = 1.0 - (1.0 - COVERAGE_PROBABILITY) / count.max(1) as f64;
    two_sided_t_factor(each, f64::INFINITY) / two_sided_t_factor(COVERAGE_PROBABILITY, f64::INFINITY)
}

/// Compares each position and travel that both runs determine. `before_mm`: the values before the compensation;
/// `control`: the values now.
///
/// # Errors
/// The runs have no determined quantity in common; their positions are stated at different points.
pub fn compare_remaining_deviations(
    first: MeasuredAxisPositions<'_>,
    second: MeasuredAxisPositions<'_>,
    control: &ControlModel,
    before_mm: &[f64],
) -> Result<Vec<RemainingDeviation>, MethodRefusal> {
    let [first, second] = at_common_point(first, second)?;
    let present_mm = control.present_mm();
    let compare = |quantity, [predicted, measured]: [MeasuredLength; 2], offsets_mm: [f64; 2]| RemainingDeviation {
        quantity,
        predicted_mm: predicted.mm + offsets_mm[0],
        measured_mm: measured.mm + offsets_mm[1],
        limit_mm: predicted.expanded_mm.hypot(measured.expanded_mm),
    };
    let mut all = Vec::new();
    for (position, present_mm) in control.positions.iter().zip(control.positions_mm(&present_mm)) {
        let coordinate = position.coordinate;
        if let (Ok(one), Ok(other)) = (first.position(coordinate), second.position(coordinate)) {
            all.push(compare(CorrectedQuantity::Position(coordinate), [one, other], [-present_mm; 2]));
        }
    }
    for own in &control.travels {
        // The second run measures what the new correction leaves.
        let change_mm = own.correction_mm(&present_mm) - own.correction_mm(before_mm);
        if let (Ok(one), Ok(other)) = (first.travel_error(own.travel), second.travel_error(own.travel)) {
            all.push(compare(CorrectedQuantity::Travel(own.travel), [one, other], [change_mm, 0.0]));
        }
    }
    MethodRefusal::require(
        !all.is_empty(),
        "the run determines nothing that the compensation has changed",
        "verify with a run of the same method, at other positions",
    )?;
    let ratio = joint_coverage_ratio(all.len());
    all.iter_mut().for_each(|own| own.limit_mm *= ratio);
    Ok(all)
}

/// A tilted axis has another position at another point: both runs state theirs at the same one.
fn at_common_point<'a>(
    first: MeasuredAxisPositions<'a>,
    second: MeasuredAxisPositions<'a>,
) -> Result<[MeasuredAxisPositions<'a>; 2], MethodRefusal> {
    let at = match [&first, &second].map(MeasuredAxisPositions::fixed_at) {
        [Some(one), Some(other)] if (one - other).norm() > MAX_REFERENCE_DISTANCE_MM => {
            return Err(MethodRefusal::new(
                "the two runs state the positions of the axes at different points",
                "verify with a run at the same place of the table, or with samba",
            ));
        }
        [Some(at), _] | [None, Some(at)] => Some(at),
        [None, None] => first.at_mm().map(Into::into),
    };
    Ok([first.stated_at(at), second.stated_at(at)])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By Python's `statistics.NormalDist`.
    #[test]
    fn joint_limits_follow_from_quantiles_of_the_normal_distribution() {
        for (count, expected) in [(1, 1.0), (4, 1.265480247), (60, 1.683784998)] {
            assert!((joint_coverage_ratio(count) - expected).abs() < 1e-6, "{count}");
        }
    }
}
