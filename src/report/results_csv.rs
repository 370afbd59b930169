//! The results file: one row per parameter, CSV in UTF-8, for spreadsheets and programs.

use std::io;

use super::result_row::{ResultRow, RunContext, result_rows};
use machine::record::estimate::Estimate;

const COLUMNS: [&str; 12] =
    ["symbol", "name", "value", "u", "U", "k", "dof", "unit", "limit", "verdict", "conformity", "text"];

/// Writes the results of `estimate` with the digits of the report. The numbers have an ASCII minus sign, which programs
/// read; `text` is the result as the other outputs display it. The numbers of a parameter that is not identifiable are
/// empty.
///
/// # Errors
/// `output` cannot be written.
pub fn write_results(estimate: &Estimate, output: impl io::Write) -> io::Result<()> {
    let mut table = csv::Writer::from_writer(output);
    table.write_record(COLUMNS)?;
    for row in result_rows(RunContext::from_estimate(estimate), &estimate.parameters) {
        table.write_record(row_fields(&row))?;
    }
    table.flush()
}

fn row_fields(row: &ResultRow) -> [String; 12] {
    let number = |text: &str| if row.identifiable { text.replace('−', "-") } else { String::new() };
    let limit = row.limit.as_deref().map_or(String::new(), |limit| limit.trim_start_matches('±').to_owned());
    [
        row.symbol.clone(),
        row.name.clone(),
        number(&row.value),
        number(&row.u),
        number(&row.expanded),
        number(&row.k),
        number(&row.dof),
        row.unit.to_owned(),
        limit,
        row.verdict.map_or(String::new(), |verdict| verdict.to_string()),
        row.conformance.clone().unwrap_or_default(),
        row.sentence.clone(),
    ]
}
