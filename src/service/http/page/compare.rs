//! Comparison page of two runs.

use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::response::Html;
use minijinja::{Value, context};

use super::{render_page, row_of_run};
use crate::archive::compare::{CompareError, RunComparison};
use crate::report::difference::difference_rows;
use crate::report::number::{argument_unit_symbol, decimals_for_uncertainty, format_fixed, split_into_base_and_index};
use crate::service::http::AppState;
use crate::service::http::api::{RunPair, compare_pair};
use crate::service::http::problem::Problem;
use methods::decision::function_difference::FunctionDifference;

pub async fn compare_page(State(app): State<AppState>, Query(pair): Query<RunPair>) -> Result<Html<String>, Problem> {
    let RunComparison { runs, differences, functions, common_sources, other_differences: besides } =
        compare_pair(&app, pair).await?;
    render_page(
        "compare.html",
        app.access.requires_tokens,
        context! {
            runs => runs.iter().map(row_of_run).collect::<Vec<_>>(),
            rows => difference_rows(&runs[1].method, &differences),
            functions => functions.iter().filter_map(function_difference_row).collect::<Vec<_>>(),
            common_sources,
            besides,
        },
    )
}

/// Row of a function, with the point of the largest E_n; `None` for a function without points.
fn function_difference_row(function: &FunctionDifference) -> Option<Value> {
    let worst = function.worst_point_index()?;
    let decimals = decimals_for_uncertainty(function.expanded[worst]);
    let number = |value: f64| format_fixed(value, decimals);
    let (base, index) = split_into_base_and_index(&function.symbol);
    Some(context! {
        base,
        index,
        unit => function.unit.symbol(),
        agreeing => function.agreeing_point_count(),
        points => function.x.len(),
        at => format!("{} {}", format_fixed(function.x[worst], 1), argument_unit_symbol(&function.argument_unit)),
        by => number(function.by[worst]),
        expanded => number(function.expanded[worst]),
        e_n => format_fixed(function.normalized_errors[worst], 2),
        significant => function.agreeing_point_count() < function.x.len(),
    })
}

impl From<CompareError> for Problem {
    fn from(error: CompareError) -> Self {
        let remedy = error.remedy();
        match error {
            CompareError::Store(error) => error.into(),
            other => Self::new(StatusCode::CONFLICT, "no-comparison", other.to_string(), remedy),
        }
    }
}
