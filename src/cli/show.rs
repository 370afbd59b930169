//! Printing of estimates, and writing of reports.

use std::path::Path;

use serde::Serialize;

use super::failure::Failure;
use crate::archive::report::report;
use crate::store::{Journal, RunId};
use machine::record::estimate::{Estimate, LimitVerdict, Unit, Verdict};

pub fn print_json(value: &impl Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(value).map_err(Failure::plain)?;
    say!("{text}");
    Ok(())
}

pub fn print_estimate(estimate: &Estimate) {
    let is_judged = estimate.parameters.iter().any(|p| p.judged.is_some());
    let more = if is_judged { "       limit  verdict" } else { "" };
    say!("{:<12} {:>12} {:>9} {:>9} {:>6}  unit{more}", "parameter", "value", "u", "U", "k");
    for p in &estimate.parameters {
        // All values to about a nanometre.
        let digits = if p.unit == Unit::Mm { 5 } else { 3 };
        say!(
            "{:<12} {:>12.digits$} {:>9.digits$} {:>9.digits$} {:>6.2}  {}{}{}",
            p.symbol,
            p.value,
            p.u,
            p.expanded,
            p.k,
            p.unit.symbol(),
            p.judged.as_ref().map_or(String::new(), |judged| in_columns(judged, p.unit)),
            p.interval_monte_carlo.map_or(String::new(), |[least, most]| {
                format!("  [{least:.digits$}, {most:.digits$}]")
            })
        );
    }
    if let Some(trials) = estimate.trials {
        say!("[ , ]: shortest interval of the same coverage by {trials} Monte Carlo trials");
    }
    say!(
        "residuals {:.2} µm rms, {} degrees of freedom, χ² {:.2} of what is expected; rank {} of {}, condition {:.1}",
        estimate.residual_rms_um,
        estimate.degrees_of_freedom,
        estimate.chi2_per_dof,
        estimate.rank,
        estimate.unknowns,
        estimate.condition
    );
    if let Some(weakest) = &estimate.weakest {
        say!("least certain: {weakest}");
    }
    for line in &estimate.gauge {
        say!("convention: {line}");
    }
    for line in &estimate.not_identifiable {
        say!("not identifiable: {line}");
    }
    for line in &estimate.warnings {
        say!("warning: {line}");
    }
    let names = |verdict: Verdict| estimate.with_verdict(verdict).join(", ");
    say!("verdict: {}", in_words(estimate.verdict));
    for (verdict, what) in [(Verdict::Fail, "out of tolerance"), (Verdict::Undecided, "undecided")]
    {
        if !names(verdict).is_empty() {
            say!("{what}: {}", names(verdict));
        }
    }
}

/// Limit, verdict and probability of conformance.
fn in_columns(LimitVerdict { limit, verdict, conformance }: &LimitVerdict, unit: Unit) -> String {
    let conformance = conformance.map(|p| format!(" (conforms with {:.1} %)", 100.0 * p));
    let width = 16 - unit.symbol().chars().count();
    format!("{limit:>width$.3}  {verdict}{}", conformance.unwrap_or_default())
}

pub fn in_words(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Pass => "pass (inside tolerance with its uncertainty)",
        Verdict::Fail => "fail (outside tolerance beyond its uncertainty)",
        Verdict::Undecided => "undecided (the uncertainty reaches across the tolerance)",
        Verdict::UndecidedModel => {
            "undecided (model: the readings contradict it or what is declared; each U is a lower bound)"
        }
        Verdict::None => "none (no tolerance is stated)",
    }
}

/// Writes the report of a stored run's last estimate.
pub fn write_report(journal: &Journal, run: RunId, file: &Path) -> Result<(), Failure> {
    let html =
        report(journal, run).map_err(|error| Failure::new(error.to_string(), error.remedy()))?;
    std::fs::write(file, html).map_err(|error| Failure::file(file, &error))
}
