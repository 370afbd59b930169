//! Differences of a result from that of an earlier run.

use minijinja::{Value, context};

use super::number::{decimals_for_uncertainty, format_fixed, split_into_base_and_index};
use methods::decision::parameter_difference::ParameterDifference;
use methods::named_symbol::named_symbol;
use methods::symbol_names::ResultGroup;

/// Comparison with the previous finished run of the same machine and method.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PreviousRun {
    /// Number and time of that run.
    pub title: String,
    /// This run minus the previous run.
    pub differences: Vec<ParameterDifference>,
    /// Sources of uncertainty with the same value in both runs. Their effects cancel in the differences.
    pub common_sources: Vec<String>,
    /// Differences other than those of results, in words.
    pub other_differences: Vec<String>,
}

/// Template values of the comparison: the rows of the main results.
pub fn previous_run_values(method: &str, previous: &PreviousRun) -> Value {
    let is_main = |difference: &&ParameterDifference| {
        named_symbol(method, &difference.symbol).is_none_or(|named| named.group == ResultGroup::Main)
    };
    let main: Vec<ParameterDifference> = previous.differences.iter().filter(is_main).cloned().collect();
    context! {
        run => previous.title.as_str(),
        rows => difference_rows(method, &main),
        common_sources => previous.common_sources.clone(),
        other_differences => previous.other_differences.clone(),
    }
}

/// Rows of the differences between two runs of `method`.
pub fn difference_rows(method: &str, differences: &[ParameterDifference]) -> Vec<Value> {
    differences.iter().map(|difference| difference_row(method, difference)).collect()
}

fn difference_row(method: &str, difference: &ParameterDifference) -> Value {
    let ParameterDifference { symbol, unit, first, second, by, expanded, normalized_error, significant } = difference;
    let decimals = decimals_for_uncertainty(*expanded);
    let number = |value: f64| format_fixed(value, decimals);
    let (base, index) = split_into_base_and_index(symbol);
    context! {
        plain => symbol.as_str(),
        base,
        index,
        name => named_symbol(method, symbol).map_or(String::new(), |named| named.name),
        unit => unit.symbol(),
        first => number(*first),
        second => number(*second),
        by => number(*by),
        expanded => number(*expanded),
        e_n => format_fixed(*normalized_error, 2),
        significant,
    }
}
