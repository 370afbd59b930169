//! The verification in rows and sentences, for the terminal and the page.

use serde::Serialize;

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
    /// Limit of the difference of both.
    pub limit: String,
    pub is_within_limit: bool,
}

#[derive(Debug, Serialize)]
pub struct VerificationTable {
    pub rows: Vec<VerificationRow>,
    /// The tool centre of the control, and the result.
    pub sentences: Vec<String>,
    pub is_confirmed: bool,
}

impl VerificationTable {
    pub fn new(verification: &Verification) -> Self {
        let is_confirmed = verification.is_confirmed();
        let tool_centre = match verification.tool_centres.is_empty() {
            true => "The tool centre of the control was not read: state tool_centre in [controller].".to_owned(),
            false => describe_tool_centre(verification),
        };
        let result = match is_confirmed {
            true => "The second run measured what the first one predicts: the compensation is verified.",
            false => {
                "The second run did not measure what the first one predicts. Restore the values before (`trued compensate \
                 undo`), or find out what has changed since the first run. All readings are kept."
            }
        };
        Self {
            rows: verification.deviations.iter().map(row).collect(),
            sentences: vec![tool_centre, result.to_owned()],
            is_confirmed,
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
        is_within_limit: own.is_within_limit(),
    }
}

fn describe_tool_centre(verification: &Verification) -> String {
    let largest_um = |mm: &dyn Fn(usize) -> f64| {
        let all = (0..verification.tool_centres.len()).map(mm);
        format_fixed(all.fold(0.0, f64::max) * 1e3, 1)
    };
    let own = |index: usize| &verification.tool_centres[index];
    format!(
        "The control stated its tool centre at {} standstills. Largest error of the tool there: {} µm measured, {} µm \
         predicted. Tool centre of the control minus that of its values: at most {} µm.",
        verification.tool_centres.len(),
        largest_um(&|index| length(own(index).measured_mm)),
        largest_um(&|index| length(own(index).predicted_mm)),
        largest_um(&|index| own(index).control_deviation_mm),
    )
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
