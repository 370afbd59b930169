//! Comparison page of two runs.

use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::response::Html;
use minijinja::{Value, context};

use super::{row, whole};
use crate::archive::compare::{CompareError, Comparison};
use crate::service::http::AppState;
use crate::service::http::api::{Pair, of_two};
use crate::service::http::problem::Problem;
use methods::decision::difference::Difference;
use methods::decision::function_difference::FunctionDifference;

pub async fn page(
    State(web): State<AppState>,
    Query(pair): Query<Pair>,
) -> Result<Html<String>, Problem> {
    let Comparison { runs, differences, functions, common_sources, besides } =
        of_two(&web, pair).await?;
    whole(
        "compare.html",
        web.access.demanded(),
        context! {
            runs => runs.iter().map(row).collect::<Vec<_>>(),
            rows => differences.iter().map(line).collect::<Vec<_>>(),
            functions => functions.iter().filter_map(function).collect::<Vec<_>>(),
            common_sources,
            besides,
        },
    )
}

fn line(difference: &Difference) -> Value {
    let Difference { symbol, unit, first, second, by, expanded, normalized, significant } =
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
fn function(function: &FunctionDifference) -> Option<Value> {
    let worst = function.worst()?;
    let number = |value: f64| format!("{value:.2}");
    Some(context! {
        symbol => function.symbol.as_str(),
        unit => function.unit.symbol(),
        agreeing => function.agreeing(),
        points => function.x.len(),
        at => format!("{:.1} {}", function.x[worst], function.argument_unit),
        by => format!("{:+.2}", function.by[worst]),
        expanded => number(function.expanded[worst]),
        e_n => number(function.normalized[worst]),
        significant => function.agreeing() < function.x.len(),
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
