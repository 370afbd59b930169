//! The results of a run as a CSV file.

use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::response::IntoResponse;

use super::AppState;
use super::problem::Problem;
use crate::report::results_csv::write_results;
use crate::store::RunId;

/// Results of a run: symbol, name, value, u, U, k, degrees of freedom, unit, limit and verdict of each parameter.
#[utoipa::path(get, path = "/api/v1/runs/{run}/results.csv", operation_id = "results", params(("run" = i64, Path)), responses((status = OK, body = String, content_type = "text/csv")))]
pub async fn get_results_file(
    State(app): State<AppState>,
    Path(run): Path<i64>,
) -> Result<impl IntoResponse + use<>, Problem> {
    let mut stored = app.read_journal(move |journal| journal.load_run(RunId(run))).await??;
    let last = stored.estimates.pop().ok_or_else(|| Problem::not_found(format!("estimate of run {run}")))?;
    let mut table = Vec::new();
    let to_problem = |error: std::io::Error| {
        let remedy = "report this fault of the program to the developers";
        Problem::new(StatusCode::INTERNAL_SERVER_ERROR, "results", error.to_string(), remedy)
    };
    write_results(&last.estimate, &mut table).map_err(to_problem)?;
    let name = format!("attachment; filename=\"run-{run}-results.csv\"");
    Ok(([(CONTENT_TYPE, "text/csv; charset=utf-8".to_owned()), (CONTENT_DISPOSITION, name)], table))
}
