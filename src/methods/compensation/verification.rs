//! Verification: what a second run finds after a compensation, against what the first one predicts.

use estimation::coverage::{COVERAGE_PROBABILITY, two_sided_t_factor};
use serde::Serialize;

use super::axis_positions::{MeasuredAxisPositions, MeasuredLength, RotaryAxisCoordinate};
use super::control_model::ControlModel;
use super::travel::AxisTravel;
use crate::MethodRefusal;

/// Distance of two reference points, mm, from which positions that are stated at them cannot be compared.
const MAX_REFERENCE_DISTANCE_MM: f64 = 1e-6;
/// Change below which a quantity counts as unchanged, mm.
const UNCHANGED_MM: f64 = 1e-9;
/// Largest rounding of a position, mm: half a step of 1 µm for each of two values.
const MAX_ROUNDING_MM: f64 = 1e-3;

/// What a value of the control corrects.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(untagged)]
pub enum CorrectedQuantity {
    Position(RotaryAxisCoordinate),
    Travel(AxisTravel),
}

/// Error of a corrected quantity after the compensation, mm: true minus control position of a rotary axis, or excess
/// travel of a linear axis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RemainingDeviation {
    #[serde(flatten)]
    pub quantity: CorrectedQuantity,
    /// Change of the position or correction in the control by the compensation.
    pub change_mm: f64,
    /// Remaining error according to the run from which the compensation was computed.
    pub predicted_mm: f64,
    /// Limit of the magnitude of `predicted_mm`: U of the first run plus rounding. Above it, the value was not computed
    /// from that run.
    pub prediction_limit_mm: f64,
    /// Remaining error according to the second run.
    pub measured_mm: f64,
    /// Limit of the difference of measured and predicted error: with correct values, all differences of a
    /// verification are below their limits with the probability 95.45 %.
    pub limit_mm: f64,
}

impl RemainingDeviation {
    /// Whether the predicted error is within `prediction_limit_mm`, and measured minus predicted error within
    /// `limit_mm`.
    pub fn is_within_limits(&self) -> bool {
        self.predicted_mm.abs() <= self.prediction_limit_mm
            && (self.measured_mm - self.predicted_mm).abs() <= self.limit_mm
    }
}

/// Factor of the expanded uncertainty with which `count` comparisons hold together with the probability 95.45 %
/// (Bonferroni), for uncertainties with `dof` degrees of freedom.
pub fn joint_coverage_ratio(count: usize, dof: f64) -> f64 {
    let each = 1.0 - (1.0 - COVERAGE_PROBABILITY) / count.max(1) as f64;
    two_sided_t_factor(each, dof) / two_sided_t_factor(COVERAGE_PROBABILITY, dof)
}

/// Compares each position and travel that both runs determine. `before_mm`: the values before the compensation;
/// `control`: the values now; `ratio`: as [`joint_coverage_ratio`]. Sources that both runs share count as independent,
/// which makes the limits larger.
///
/// # Errors
/// A run does not determine a changed quantity; the limit for the largest change is not smaller than that change (also
/// without any change); the positions of the runs are stated at different points.
pub fn compare_remaining_deviations(
    first: MeasuredAxisPositions<'_>,
    second: MeasuredAxisPositions<'_>,
    control: &ControlModel,
    before_mm: &[f64],
    ratio: f64,
) -> Result<Vec<RemainingDeviation>, MethodRefusal> {
    let [first, second] = at_common_point(first, second)?;
    let present_mm = control.present_mm();
    let mut all = Vec::new();
    let mut compare =
        |quantity, change_mm: f64, both: [Result<MeasuredLength, MethodRefusal>; 2], offsets_mm: [f64; 2]| {
            let [predicted, measured] = match both {
                [Ok(predicted), Ok(measured)] => [predicted, measured],
                [Err(refusal), _] | [_, Err(refusal)] if change_mm.abs() > UNCHANGED_MM => return Err(refusal),
                _ => return Ok(()),
            };
            all.push(RemainingDeviation {
                quantity,
                change_mm,
                predicted_mm: predicted.mm + offsets_mm[0],
                prediction_limit_mm: predicted.expanded_mm + MAX_ROUNDING_MM,
                measured_mm: measured.mm + offsets_mm[1],
                limit_mm: ratio * predicted.expanded_mm.hypot(measured.expanded_mm),
            });
            Ok(())
        };
    let [positions_before_mm, positions_mm] = [before_mm, &present_mm].map(|values_mm| control.positions_mm(values_mm));
    for ((position, before_mm), mm) in control.positions.iter().zip(positions_before_mm).zip(positions_mm) {
        let quantity = CorrectedQuantity::Position(position.coordinate);
        let both = [&first, &second].map(|run| run.position(position.coordinate));
        compare(quantity, mm - before_mm, both, [-mm; 2])?;
    }
    for own in &control.travels {
        // The second run measures what the new correction leaves.
        let change_mm = own.correction_mm(&present_mm) - own.correction_mm(before_mm);
        let both = [&first, &second].map(|run| run.travel_error(own.travel));
        compare(CorrectedQuantity::Travel(own.travel), change_mm, both, [change_mm, 0.0])?;
    }
    check_shows_largest_change(&all)?;
    Ok(all)
}

/// Refuses if the limit for the largest change is not smaller than this change: a run with a large U would confirm
/// any value.
fn check_shows_largest_change(all: &[RemainingDeviation]) -> Result<(), MethodRefusal> {
    let largest = all.iter().max_by(|one, other| one.change_mm.abs().total_cmp(&other.change_mm.abs()));
    let [change_um, limit_um] =
        [largest.map_or(0.0, |own| own.change_mm.abs()), largest.map_or(0.0, |own| own.limit_mm)].map(|mm| mm * 1e3);
    MethodRefusal::require(
        all.iter().all(|own| own.limit_mm.is_finite()) && limit_um < change_um,
        format!(
            "the runs cannot show whether the largest change of {change_um:.1} µm is right: the limit of the difference is \
             {limit_um:.1} µm"
        ),
        "verify with a run of smaller uncertainty",
    )
}

/// A tilted axis has another position at another point: both runs state theirs at the same one.
fn at_common_point<'a>(
    first: MeasuredAxisPositions<'a>,
    second: MeasuredAxisPositions<'a>,
) -> Result<[MeasuredAxisPositions<'a>; 2], MethodRefusal> {
    let at = match [&first, &second].map(MeasuredAxisPositions::only_valid_point_mm) {
        [Some(one), Some(other)] if (one - other).norm() > MAX_REFERENCE_DISTANCE_MM => {
            return Err(MethodRefusal::new(
                "the two runs state the positions of the axes at different points",
                "verify with a run at the same place of the table, or with samba",
            ));
        }
        [Some(at), _] | [None, Some(at)] => Some(at),
        [None, None] => first.at_mm().map(Into::into),
    };
    Ok([first.with_reference_point(at), second.with_reference_point(at)])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By Python's `statistics.NormalDist`.
    #[test]
    fn joint_limits_follow_from_quantiles_of_the_normal_distribution() {
        for (count, expected) in [(1, 1.0), (4, 1.265480247), (60, 1.683784998)] {
            assert!((joint_coverage_ratio(count, f64::INFINITY) - expected).abs() < 1e-6, "{count}");
        }
    }
}
