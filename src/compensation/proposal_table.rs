//! The proposal in rows and sentences, for the terminal and the page.

use serde::Serialize;

use super::proposal::ControlProposal;
use super::verification_table::quantity_name;
use crate::report::number::{decimals_for_uncertainty, format_fixed, one_line_symbol, with_one_line_symbols};
use methods::compensation::{CorrectedQuantity, ProposedPosition, ProposedTravel, ProposedValue};

/// Decimals of a value in mm.
const MM_DECIMALS: usize = 4;

/// A position of a rotary axis, or the correction of the travel of a linear axis, mm. Missing numbers are a dash.
#[derive(Debug, Serialize)]
pub struct PositionRow {
    /// e.g. `X of C`, or `X from -300 to 300`.
    pub name: String,
    pub present: String,
    /// Measured position, or required correction of the travel.
    pub measured: String,
    /// U of `measured`.
    pub expanded: String,
    pub proposed: String,
    /// Reason why the present position is kept, and remedy.
    pub kept: Option<String>,
}

/// A value of the control, mm.
#[derive(Debug, Serialize)]
pub struct ValueRow {
    pub name: String,
    pub present: String,
    pub proposed: String,
    pub is_changed: bool,
}

#[derive(Debug, Serialize)]
pub struct ProposalTable {
    pub positions: Vec<PositionRow>,
    pub travels: Vec<PositionRow>,
    pub values: Vec<ValueRow>,
    /// Notes on the values, the point where the positions are valid, the predicted error, the warnings, and the errors
    /// that are not corrected.
    pub sentences: Vec<String>,
}

impl ProposalTable {
    pub fn new(proposal: &ControlProposal) -> Self {
        let values =
            proposal.proposal.values.iter().map(|ProposedValue { name, present_mm, proposed_mm, .. }| ValueRow {
                name: name.clone(),
                present: format_fixed(*present_mm, MM_DECIMALS),
                proposed: format_fixed(*proposed_mm, MM_DECIMALS),
                is_changed: present_mm != proposed_mm,
            });
        Self {
            positions: proposal.proposal.positions.iter().map(position_row).collect(),
            travels: proposal.proposal.travels.iter().map(travel_row).collect(),
            values: values.collect(),
            sentences: sentences(proposal),
        }
    }
}

fn position_row(position: &ProposedPosition) -> PositionRow {
    let number = |mm: f64| format_fixed(mm, MM_DECIMALS);
    let number_or_dash = |mm: Option<f64>| mm.map_or("–".to_owned(), number);
    PositionRow {
        name: position_name(position),
        present: number(position.present_mm),
        measured: number_or_dash(position.measured_mm),
        expanded: number_or_dash(position.expanded_mm),
        proposed: number(position.proposed_mm),
        kept: position.kept.as_ref().map(|why| format!("{}; {}", why.reason, why.remedy)),
    }
}

fn travel_row(own: &ProposedTravel) -> PositionRow {
    let number = |mm: f64| format_fixed(mm, MM_DECIMALS);
    let number_or_dash = |mm: Option<f64>| mm.map_or("–".to_owned(), number);
    PositionRow {
        name: quantity_name(CorrectedQuantity::Travel(own.travel)),
        present: number(own.present_mm),
        measured: number_or_dash(own.required_mm),
        expanded: number_or_dash(own.expanded_mm),
        proposed: number(own.proposed_mm),
        kept: own.kept.as_ref().map(|why| format!("{}; {}", why.reason, why.remedy)),
    }
}

fn sentences(proposal: &ControlProposal) -> Vec<String> {
    let mut sentences = proposal.notes.clone();
    if let Some(at_mm) = proposal.proposal.at_mm.filter(|_| !proposal.proposal.positions.is_empty()) {
        let [x, y, z] = at_mm.map(|mm| format_fixed(mm, 1));
        sentences.push(format!(
            "the positions are valid with the tip at machine position X {x} Y {y} Z {z} mm, and a stylus of {} mm",
            format_fixed(proposal.stylus_length_mm, 1)
        ));
    }
    if let Some(predicted) = proposal.predicted {
        let [present, proposed] = predicted.map(|error| {
            format!("({} ± {}) µm", format_fixed(error.largest_um, 1), format_fixed(error.expanded_largest_um, 1))
        });
        sentences.push(format!(
            "largest position error of the tool with tool centre point control, predicted over the measured ranges: \
             {present} with the present values, {proposed} with the proposed values (U, k = 2)"
        ));
    }
    let undetermined = proposal.proposal.positions.iter().filter(|position| position.measured_mm.is_none());
    let undetermined: Vec<String> = undetermined.map(position_name).collect();
    if !undetermined.is_empty() {
        sentences.push(format!("the prediction assumes correct present values of {}", undetermined.join(", ")));
    }
    let warnings = proposal.warnings.iter();
    sentences.extend(warnings.map(|warning| format!("warning of the run: {}", with_one_line_symbols(warning))));
    sentences.extend(proposal.remaining.iter().map(|error| {
        let decimals = decimals_for_uncertainty(error.expanded);
        let [value, expanded] = [error.value, error.expanded].map(|number| format_fixed(number, decimals));
        let unit = error.unit.symbol();
        format!("not corrected: {} {value} {unit}, U {expanded} {unit}", one_line_symbol(&error.symbol))
    }));
    sentences
}

fn position_name(position: &ProposedPosition) -> String {
    quantity_name(CorrectedQuantity::Position(position.coordinate))
}
