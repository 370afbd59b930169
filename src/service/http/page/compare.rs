//! Comparison page of two runs.

use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::response::Html;
use minijinja::{Value, context};

use super::{render_page, row_of_run};
use crate::archive::compare::{CompareError, RunComparison};
use crate::service::http::AppState;
use crate::service::http::api::{RunPair, compare_pair};
use crate::service::http::problem::Problem;
use methods::decision::function_difference::FunctionDifference;
use methods::decision::parameter_difference::ParameterDifference;

pub async fn compare_page(State(app): State<AppState>, Query(pair): Query<RunPair>) -> Result<Html<String>, Problem> {
    let RunComparison { runs, differences, functions, common_sources, besides } = compare_pair(&app, pair).await?;
    render_page(
        "compare.html",
        app.access.requires_tokens,
        context! {
            runs => runs.iter().map(row_of_run).collect::<Vec<_>>(),
            rows => differences.iter().map(difference_row).collect::<Vec<_>>(),
            functions => functions.iter().filter_map(function_difference_row).collect::<Vec<_>>(),
            common_sources,
            besides,
        },
    )
}

fn difference_row(difference: &ParameterDifference) -> Value {
    let ParameterDifference { symbol, unit, first, second, by, expanded, normalized_error: normalized, significant } =
        difference;
    let number = |value: &f64| format!("{value:.2}");
    context! {
        symbol,
        unit => unit.symbol(),
        first => number(first),
        second => number(second),
        by => format!("{by:+.2}"),
        expanded => number(expanded),
        e_n => number(normalized),
        significant,
    }
}

/// Row of a function, with the point of the largest E_n.
fn function_difference_row(function: &FunctionDifference) -> Option<Value> {
    let worst = function.worst_point_index()?;
    let number = |value: f64| format!("{value:.2}");
    Some(context! {
        symbol => function.symbol.as_str(),
        unit => function.unit.symbol(),
        agreeing => function.agreeing_point_count(),
        points => function.x.len(),
        at => format!("{:.1} {}", function.x[worst], function.argument_unit),
        by => format!("{:+.2}", function.by[worst]),
        expanded => number(function.expanded[worst]),
        e_n => number(function.normalized_errors[worst]),
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
