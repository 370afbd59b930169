//! Printing of estimates, and writing of reports.

use std::path::Path;

use serde::Serialize;

use super::failure::CommandFailure;
use crate::archive::report::render_report;
use crate::report::number::with_one_line_symbols;
use crate::report::result_row::{ResultRow, RunContext, result_rows, rows_not_passed, verdict_sentence, verdict_word};
use crate::store::{Journal, RunId};
use machine::record::estimate::{Estimate, Verdict};

pub fn print_json(value: &impl Serialize) -> Result<(), CommandFailure> {
    let text = serde_json::to_string_pretty(value).map_err(CommandFailure::without_remedy)?;
    outln!("{text}");
    Ok(())
}

pub fn print_estimate(estimate: &Estimate) {
    let rows = result_rows(RunContext::from_estimate(estimate), &estimate.parameters);
    print_result_table(&rows);
    if let Some(trials) = estimate.trials {
        outln!(
            "[a to b]: shortest coverage interval from {trials} Monte Carlo trials, with the same coverage probability"
        );
    }
    outln!(
        "residuals {:.2} µm rms, {} degrees of freedom, χ² {:.2} times its expected value; rank {} of {}, \
        condition {:.1}",
        estimate.residual_rms_um,
        estimate.degrees_of_freedom,
        estimate.chi2_per_dof,
        estimate.rank,
        estimate.unknowns,
        estimate.condition
    );
    if let Some(weakest) = &estimate.weakest {
        outln!("weakest combination of parameters: {}", with_one_line_symbols(weakest));
    }
    let Estimate { gauge, not_identifiable, warnings, .. } = estimate;
    for (title, lines) in [("convention", gauge), ("not identifiable", not_identifiable), ("warning", warnings)] {
        lines.iter().for_each(|line| outln!("{title}: {}", with_one_line_symbols(line)));
    }
    print_verdict(estimate.verdict, &rows);
}

fn print_result_table(rows: &[ResultRow]) {
    outln!(
        "{:<12} {:>12} {:>9} {:>9} {:>6}  {:<5} {:>8}  verdict",
        "parameter",
        "value",
        "u",
        "U",
        "k",
        "unit",
        "limit"
    );
    for row in rows {
        let ResultRow { one_line_symbol, value, u, expanded, k, unit, name, .. } = row;
        let limit = row.limit.as_deref().unwrap_or_default();
        let verdict = row.verdict_word.unwrap_or_default();
        let conformance = row.conformance.iter().map(|p| format!(" (probability of conformity {p})"));
        let interval = row.interval.iter().map(|ends| format!(" [{ends}]"));
        let more: String = conformance.chain(interval).collect();
        let numbers = match row.identifiable {
            true => format!("{value:>12} {u:>9} {expanded:>9} {k:>6}"),
            false => format!("{:>39}", "not identifiable"),
        };
        outln!("{one_line_symbol:<12} {numbers}  {unit:<5} {limit:>8}  {verdict}{more}  {name}");
    }
}

/// The verdict of the run, then each result that has not passed, worst first.
fn print_verdict(verdict: Verdict, rows: &[ResultRow]) {
    outln!("verdict: {} ({})", verdict_word(verdict), verdict_sentence(verdict));
    for row in rows_not_passed(rows) {
        outln!("  {}", row.sentence);
        if let Some(decided_by) = &row.decided_by {
            outln!("    {decided_by}");
        }
    }
}

/// Writes the report of a stored run's last estimate.
pub fn write_report(journal: &Journal, run: RunId, file: &Path) -> Result<(), CommandFailure> {
    let html = render_report(journal, run).map_err(|error| CommandFailure::new(error.to_string(), error.remedy()))?;
    std::fs::write(file, html).map_err(|error| CommandFailure::from_file_error(file, &error))
}
