//! The uncertainty budget as tables: standard uncertainty of each result by source.

use minijinja::value::Serde;
use minijinja::{Value, context};

use super::number;
use super::result_row::{ResultRow, format_degrees_of_freedom};
use machine::record::estimate::{BudgetLine, Distribution, EvaluationType, Parameter};

/// Budget of the identifiable parameters with a budget for which `is_in_table` holds: a row per parameter, a column per
/// source.
pub fn budget_value(parameters: &[Parameter], rows: &[ResultRow], is_in_table: impl Fn(&ResultRow) -> bool) -> Value {
    let pairs = parameters.iter().zip(rows);
    let listed: Vec<(&Parameter, &ResultRow)> =
        pairs.filter(|(parameter, row)| row.identifiable && !parameter.budget.is_empty() && is_in_table(row)).collect();
    let mut sources: Vec<&BudgetLine> = Vec::new();
    for line in listed.iter().flat_map(|(parameter, _)| &parameter.budget) {
        if sources.iter().all(|known| known.source != line.source) {
            sources.push(line);
        }
    }
    let title = |line: &&BudgetLine| format!("{}{}", line.source, if line.assumed { " (assumed)" } else { "" });
    context! {
        sources => sources.iter().map(title).collect::<Vec<_>>(),
        head => evaluation_rows(&sources),
        rows => listed.iter().map(|(parameter, row)| budget_row(parameter, row, &sources)).collect::<Vec<_>>(),
        assumed => sources.iter().any(|line| line.assumed),
    }
}

/// Row of a parameter: its contribution to the standard uncertainty u from each of `sources`, empty without one, and
/// u.
fn budget_row(parameter: &Parameter, row: &ResultRow, sources: &[&BudgetLine]) -> Value {
    let decimals = number::decimals_for_uncertainty(parameter.u);
    let share = |source: &&BudgetLine| {
        let line = parameter.budget.iter().find(|line| line.source == source.source);
        line.map_or(String::new(), |line| number::format_fixed(line.u, decimals))
    };
    context! {
        result => Serde(row),
        shares => sources.iter().map(share).collect::<Vec<_>>(),
        u => number::format_fixed(parameter.u, decimals),
    }
}

/// Evaluation of the sources, each by the first parameter that has the source: a row per property, a column per
/// source.
fn evaluation_rows(sources: &[&BudgetLine]) -> Vec<Value> {
    let row = |name: &str, text: &dyn Fn(&BudgetLine) -> String| {
        let texts: Vec<String> = sources.iter().map(|line| text(line)).collect();
        context! { name, texts }
    };
    let or_nothing = |text: Option<&str>| text.unwrap_or_default().to_owned();
    vec![
        row("Type", &|line| or_nothing(line.evaluation_type.map(EvaluationType::as_str))),
        row("Distribution", &|line| or_nothing(line.distribution.map(Distribution::as_str))),
        row("Degrees of freedom", &|line| format_degrees_of_freedom(line.dof)),
    ]
}
