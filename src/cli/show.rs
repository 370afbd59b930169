//! Printing of estimates, and writing of reports.

use std::path::Path;

use serde::Serialize;

use super::failure::CommandFailure;
use crate::archive::report::render_report;
use crate::store::{Journal, RunId};
use machine::record::estimate::{Estimate, LimitVerdict, Unit, Verdict};

pub fn print_json(value: &impl Serialize) -> Result<(), CommandFailure> {
    let text = serde_json::to_string_pretty(value).map_err(CommandFailure::without_remedy)?;
    outln!("{text}");
    Ok(())
}

pub fn print_estimate(estimate: &Estimate) {
    let has_limits = estimate.parameters.iter().any(|p| p.judged.is_some());
    let more = if has_limits { "       limit  verdict" } else { "" };
    outln!("{:<12} {:>12} {:>9} {:>9} {:>6}  unit{more}", "parameter", "value", "u", "U", "k");
    for p in &estimate.parameters {
        // All values to about a nanometre.
        let digits = if p.unit == Unit::Mm { 5 } else { 3 };
        outln!(
            "{:<12} {:>12.digits$} {:>9.digits$} {:>9.digits$} {:>6.2}  {}{}{}",
            p.symbol,
            p.value,
            p.u,
            p.expanded,
            p.k,
            p.unit.symbol(),
            p.judged.as_ref().map_or(String::new(), |judged| verdict_columns(judged, p.unit)),
            p.interval_monte_carlo
                .map_or(String::new(), |[least, most]| { format!("  [{least:.digits$}, {most:.digits$}]") })
        );
    }
    if let Some(trials) = estimate.trials {
        outln!(
            "[ , ]: shortest coverage interval from {trials} Monte Carlo trials, with the same coverage \
            probability"
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
        outln!("weakest combination of parameters: {weakest}");
    }
    for line in &estimate.gauge {
        outln!("convention: {line}");
    }
    for line in &estimate.not_identifiable {
        outln!("not identifiable: {line}");
    }
    for line in &estimate.warnings {
        outln!("warning: {line}");
    }
    let names = |verdict: Verdict| estimate.symbols_with_verdict(verdict).join(", ");
    outln!("verdict: {}", describe_verdict(estimate.verdict));
    for (verdict, what) in [(Verdict::Fail, "out of tolerance"), (Verdict::Undecided, "undecided")] {
        if !names(verdict).is_empty() {
            outln!("{what}: {}", names(verdict));
        }
    }
}

/// Limit, verdict and probability of conformance.
fn verdict_columns(LimitVerdict { limit, verdict, conformance }: &LimitVerdict, unit: Unit) -> String {
    let conformance = conformance.map(|p| format!(" (probability of conformity {:.1} %)", 100.0 * p));
    let width = 16 - unit.symbol().chars().count();
    format!("{limit:>width$.3}  {verdict}{}", conformance.unwrap_or_default())
}

pub fn describe_verdict(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Pass => "pass (in tolerance, with the uncertainty included)",
        Verdict::Fail => "fail (out of tolerance by more than the uncertainty)",
        Verdict::Undecided => "undecided (the limit is inside the uncertainty interval)",
        Verdict::UndecidedModel => {
            "undecided (the readings contradict the model or the declared data; each U is a lower bound)"
        }
        Verdict::None => "none (no tolerance in the machine file)",
    }
}

/// Writes the report of a stored run's last estimate.
pub fn write_report(journal: &Journal, run: RunId, file: &Path) -> Result<(), CommandFailure> {
    let html = render_report(journal, run).map_err(|error| CommandFailure::new(error.to_string(), error.remedy()))?;
    std::fs::write(file, html).map_err(|error| CommandFailure::from_file_error(file, &error))
}
