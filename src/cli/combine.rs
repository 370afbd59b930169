//! `trued combine`: combines stored runs of one machine into one estimate.

use std::path::Path;

use super::failure::CommandFailure;
use super::files::state_folder;
use super::result_args::CombineArgs;
use super::{ExitStatus, show};
use crate::report::number::{decimals_for_uncertainty, format_fixed, one_line_symbol, with_one_line_symbols};
use crate::run::{CombinationError, combine_stored_runs};
use crate::store::{Journal, RunId};
use methods::combination::{Combination, CombinedParameter};

impl From<CombinationError> for CommandFailure {
    fn from(error: CombinationError) -> Self {
        match error.remedy() {
            Some(remedy) => Self::new(&error, remedy),
            None => Self::without_remedy(error),
        }
    }
}

/// `trued combine`: combines the runs and prints the result, which is stored as the estimate of the newest run if the
/// runs agree.
pub fn combine_command(args: &CombineArgs, state: Option<&Path>) -> Result<ExitStatus, CommandFailure> {
    let journal = Journal::open(&state_folder(state)?)?;
    let runs: Vec<RunId> = args.runs.iter().map(|run| RunId(*run)).collect();
    let combination = combine_stored_runs(&journal, &runs)?;
    match args.json {
        true => show::print_json(&combination)?,
        false => print_combination(&combination),
    }
    Ok(combination.estimate.verdict.into())
}

fn print_combination(combination: &Combination) {
    let Combination { runs, parameters, consistency, estimate, .. } = combination;
    let names: String = runs.iter().map(|run| format!(" {:>12}", format!("run {run}"))).collect();
    outln!("{:<16}{names} {:>12} {:>9} {:>6} {:>5}  unit", "parameter", "combined", "U", "E_n", "run");
    parameters.iter().for_each(|parameter| print_parameter(parameter, combination));
    outln!("E_n: largest |run − combination of the other runs|/U over the runs, and its run");
    print_shared_sources(combination);
    let verdict = if consistency.is_consistent() { "the runs agree" } else { "the runs contradict each other" };
    outln!(
        "consistency: χ² = {:.1} with {} degrees of freedom, p = {}: {verdict}",
        consistency.chi2,
        consistency.degrees_of_freedom,
        format_probability(consistency.p_value)
    );
    for warning in &estimate.warnings {
        outln!("warning: {}", with_one_line_symbols(warning));
    }
    outln!("verdict: {}", estimate.verdict);
    match runs.last().filter(|_| consistency.is_consistent()) {
        Some(newest) => outln!(
            "stored as the estimate of run {newest}; earlier signatures of run {newest} do not apply to this estimate. \
            `trued identify {} --run {newest}` computes the estimate of the single run again",
            estimate.method
        ),
        None => outln!("not stored: each run keeps its estimate"),
    }
}

fn format_probability(p_value: f64) -> String {
    if p_value < 0.01 { format!("{p_value:.1e}") } else { format!("{p_value:.2}") }
}

fn print_parameter(parameter: &CombinedParameter, combination: &Combination) {
    let CombinedParameter { symbol, unit, values, combined, expanded } = parameter;
    let decimals = decimals_for_uncertainty(*expanded);
    let number = |value: f64| format_fixed(value, decimals);
    let values: String = values.iter().map(|value| format!(" {:>12}", value.map_or("–".to_owned(), number))).collect();
    let worst = combination.consistency.largest_deviation_of(symbol);
    let normalized = worst.map_or("–".to_owned(), |worst| format!("{:.2}", worst.normalized_error));
    let run = worst.map_or("–".to_owned(), |worst| worst.run.to_string());
    let mark = if worst.is_some_and(|worst| worst.disagrees) { "  disagrees" } else { "" };
    outln!(
        "{:<16}{values} {:>12} {:>9} {normalized:>6} {run:>5}  {}{mark}",
        one_line_symbol(symbol),
        number(*combined),
        number(*expanded),
        unit.symbol()
    );
}

fn print_shared_sources(combination: &Combination) {
    if combination.shared_sources.is_empty() {
        outln!("shared sources of uncertainty: none");
    }
    for shared in &combination.shared_sources {
        let correlation = match shared.has_known_correlation {
            true => "same value in each run",
            false => "correlation not known: the largest possible effect counts",
        };
        let runs: Vec<String> = shared.runs.iter().map(i64::to_string).collect();
        outln!("shared source of uncertainty: {} (runs {}; {correlation})", shared.source, runs.join(", "));
    }
}
