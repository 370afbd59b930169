//! `trued compare`: compares two stored runs.

use std::path::Path;

use super::failure::CommandFailure;
use super::files::state_folder;
use super::result_args::CompareArgs;
use super::show;
use crate::archive::compare::{CompareError, RunComparison, compare_runs};
use crate::report::number::{decimals_for_uncertainty, format_fixed, one_line_symbol};
use crate::store::{Journal, RunId};
use methods::decision::function_difference::FunctionDifference;
use methods::decision::parameter_difference::ParameterDifference;

impl From<CompareError> for CommandFailure {
    fn from(error: CompareError) -> Self {
        Self::new(&error, error.remedy())
    }
}

pub fn compare_stored_runs(args: &CompareArgs, state: Option<&Path>) -> Result<(), CommandFailure> {
    let journal = Journal::open(&state_folder(state)?)?;
    let comparison = compare_runs(&journal, RunId(args.first), RunId(args.second))?;
    match args.json {
        true => show::print_json(&comparison)?,
        false => print_comparison(&comparison),
    }
    Ok(())
}

fn print_comparison(comparison: &RunComparison) {
    let RunComparison { runs, differences, functions, common_sources, other_differences } = comparison;
    for run in runs {
        outln!("run {}: {} on {}, {:.0}", run.id, run.method, run.machine, run.started);
    }
    for words in other_differences {
        outln!("note: {words}");
    }
    print_parameter_differences(differences);
    print_function_differences(functions);
    let common = match common_sources.as_slice() {
        [] => "none: the results are treated as independent".to_owned(),
        names => format!("{} (fully correlated in both runs)", names.join(", ")),
    };
    outln!("common sources of uncertainty: {common}");
    let agreeing = differences.iter().filter(|difference| !difference.significant).count();
    outln!(
        "{agreeing} of {} parameters agree; {} of {} functions agree at all points (agreement: E_n = \
        |difference|/U is at most 1)",
        differences.len(),
        functions.iter().filter(|f| f.agreeing_point_count() == f.x.len()).count(),
        functions.len()
    );
}

fn print_parameter_differences(differences: &[ParameterDifference]) {
    if differences.is_empty() {
        return;
    }
    outln!("{:<16} {:>12} {:>12} {:>11} {:>9} {:>6}  unit", "parameter", "first", "second", "difference", "U", "E_n");
    for ParameterDifference { symbol, unit, first, second, by, expanded, normalized_error: normalized, significant } in
        differences
    {
        let mark = if *significant { "  differs" } else { "" };
        let (symbol, unit) = (one_line_symbol(symbol), unit.symbol());
        let decimals = decimals_for_uncertainty(*expanded);
        let [first, second, by, expanded] = [first, second, by, expanded].map(|value| format_fixed(*value, decimals));
        outln!("{symbol:<16} {first:>12} {second:>12} {by:>11} {expanded:>9} {normalized:>6.2}  {unit}{mark}");
    }
}

/// Prints the point with the largest E_n of each function.
fn print_function_differences(functions: &[FunctionDifference]) {
    if functions.is_empty() {
        return;
    }
    outln!("{:<16} {:>12} {:>12} {:>11} {:>9} {:>6}  unit", "function", "points", "worst at", "difference", "U", "E_n");
    for function in functions {
        let Some(worst) = function.worst_point_index() else { continue };
        let decimals = decimals_for_uncertainty(function.expanded[worst]);
        let number = |value: f64| format_fixed(value, decimals);
        let (agreeing, count) = (function.agreeing_point_count(), function.x.len());
        outln!(
            "{:<16} {:>12} {:>12} {:>11} {:>9} {:>6.2}  {}{}",
            one_line_symbol(&function.symbol),
            format!("{agreeing} of {count}"),
            format!("{:.1} {}", function.x[worst], function.argument_unit).trim_end(),
            number(function.by[worst]),
            number(function.expanded[worst]),
            function.normalized_errors[worst],
            function.unit.symbol(),
            if agreeing < count { "  differs" } else { "" }
        );
    }
    if let Some(at) = functions.iter().find_map(|function| function.gauge_at) {
        outln!(
            "from each function of an angle its value at {at}° is subtracted; U combines four standard \
            uncertainties: of two points in each of two runs"
        );
    }
}
