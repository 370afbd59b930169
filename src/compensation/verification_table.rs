//! The verification in rows and sentences, for the terminal and the page.

use serde::Serialize;

use super::tool_centre_comparison::ToolCentreError;
use super::verification::Verification;
use crate::report::number::format_fixed;
use methods::compensation::{AxisTravel, CorrectedQuantity, RemainingDeviation, RotaryAxisCoordinate};

/// An error after the compensation, µm.
#[derive(Debug, Serialize)]
pub struct VerificationRow {
    /// e.g. `X of C`, or `X from -300 to 300`.
    pub name: String,
    pub predicted: String,
    pub measured: String,
    /// Limit of |measured − predicted|.
    pub limit: String,
    /// Whether the difference is within `limit`, and the predicted error within its own limit.
    pub is_within_limits: bool,
}

#[derive(Debug, Serialize)]
pub struct VerificationTable {
    pub rows: Vec<VerificationRow>,
    /// Sentences on the tool centre of the control, and on the result.
    pub sentences: Vec<String>,
}

impl VerificationTable {
    pub fn new(verification: &Verification) -> Self {
        let tool_centre = match verification.tool_centres.as_deref() {
            None => None,
            Some([]) => {
                Some("The tool centre of the control was not read: state tool_centre in [controller].".to_owned())
            }
            Some(tool_centres) => Some(describe_tool_centres(tool_centres)),
        };
        let result = match verification.is_confirmed() {
            true => "Result: verified.",
            false => {
                "Result: not confirmed. Restore the earlier values (page of the machine, or trued compensate undo), or find \
                 out what has changed since the first run. All readings are kept."
            }
        };
        Self {
            rows: verification.deviations.iter().map(row).collect(),
            sentences: tool_centre.into_iter().chain([result.to_owned()]).collect(),
        }
    }
}

fn row(own: &RemainingDeviation) -> VerificationRow {
    let um = |mm: f64| format_fixed(mm * 1e3, 1);
    VerificationRow {
        name: quantity_name(own.quantity),
        predicted: um(own.predicted_mm),
        measured: um(own.measured_mm),
        limit: um(own.limit_mm),
        is_within_limits: own.is_within_limits(),
    }
}

fn describe_tool_centres(tool_centres: &[ToolCentreError]) -> String {
    let largest_um =
        |mm: &dyn Fn(&ToolCentreError) -> f64| format_fixed(tool_centres.iter().map(mm).fold(0.0, f64::max) * 1e3, 1);
    let predicted = match tool_centres.iter().all(|own| own.prediction.is_some()) {
        true => {
            let largest = largest_um(&|own| own.prediction.map_or(0.0, |own| length(own.predicted_mm)));
            format!("{largest} µm predicted")
        }
        false => "not compared with the prediction, because the two estimates have different errors".to_owned(),
    };
    let steps_where = |is_outside: &dyn Fn(&&ToolCentreError) -> bool| -> Vec<String> {
        tool_centres.iter().filter(is_outside).map(|own| own.step.to_string()).collect()
    };
    let mut text = format!(
        "The control stated its tool centre at {} standstills. Largest error of the tool there: {} µm measured, {predicted}. \
         Tool centre of the control minus that of its values: at most {} µm.",
        tool_centres.len(),
        largest_um(&|own| length(own.measured_mm)),
        largest_um(&|own| own.control_deviation_mm),
    );
    let [deviating, unpredicted] =
        [steps_where(&|own| !own.follows_from_values()), steps_where(&|own| !own.is_as_predicted())];
    if !deviating.is_empty() {
        text += &format!(
            " Steps after which the kinematics of the control did not apply the values as they are: {}. Check tool_centre, \
             the tool-offset pin and the sense of the rotary axes.",
            deviating.join(", ")
        );
    } else if !unpredicted.is_empty() {
        text += &format!(" Steps after which the difference exceeds its limit: {}.", unpredicted.join(", "));
    }
    text
}

fn length([x, y, z]: [f64; 3]) -> f64 {
    x.hypot(y).hypot(z)
}

/// e.g. `X of C`, or `X from -300 to 300`.
pub(super) fn quantity_name(quantity: CorrectedQuantity) -> String {
    match quantity {
        CorrectedQuantity::Position(RotaryAxisCoordinate { axis, component }) => format!("{component} of {axis}"),
        CorrectedQuantity::Travel(AxisTravel { axis, from_mm, to_mm }) => {
            format!("{axis} from {} to {}", format_fixed(from_mm, 0), format_fixed(to_mm, 0))
        }
    }
}
