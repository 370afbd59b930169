//! Files of a run to download: the same bytes as `trued export` writes.

use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::AppState;
use super::openapi::schemas::DocumentedObject;
use super::problem::Problem;
use crate::archive::report::ReportError;
use crate::archive::run_files;
use crate::store::RunId;

pub(super) const CSV_CONTENT_TYPE: &str = "text/csv; charset=utf-8";
const JSON_CONTENT_TYPE: &str = "application/json";

pub fn run_file_routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        .routes(routes!(get_readings_file))
        .routes(routes!(get_estimate_file))
        .routes(routes!(get_results_file))
}

/// All readings of a run as a CSV file, as `trued export` writes it.
#[utoipa::path(get, path = "/api/v1/runs/{run}/readings.csv", operation_id = "readings_file", params(("run" = i64, Path)), responses((status = OK, body = String, content_type = "text/csv", headers(("content-disposition" = String, description = "attachment with its file name")))))]
async fn get_readings_file(State(app): State<AppState>, Path(run): Path<i64>) -> Result<Response, Problem> {
    let run = RunId(run);
    let file = app.read_journal(move |journal| journal.load_run(run).map(|stored| run_files::readings_file(&stored)));
    let csv = file.await??.map_err(|error| unwritable_file_problem(&error))?;
    Ok(attachment(CSV_CONTENT_TYPE, &run_files::readings_file_name(run), csv))
}

/// Last estimate of a run as a JSON file, as `trued export` writes it.
#[utoipa::path(get, path = "/api/v1/runs/{run}/estimate.json", operation_id = "estimate_file", params(("run" = i64, Path)), responses((status = OK, body = DocumentedObject, headers(("content-disposition" = String, description = "attachment with its file name")))))]
async fn get_estimate_file(State(app): State<AppState>, Path(run): Path<i64>) -> Result<Response, Problem> {
    let run = RunId(run);
    let file = app.read_journal(move |journal| journal.load_run(run).map(|stored| run_files::estimate_file(&stored)));
    let json = file.await??.map_err(|error| unwritable_file_problem(&error))?;
    let json = json.ok_or(ReportError::NoEstimate(run))?;
    Ok(attachment(JSON_CONTENT_TYPE, &run_files::estimate_file_name(run), json.into_bytes()))
}

/// Results of a run: symbol, name, value, u, U, k, degrees of freedom, unit, limit and verdict of each parameter.
#[utoipa::path(get, path = "/api/v1/runs/{run}/results.csv", operation_id = "results_file", params(("run" = i64, Path)), responses((status = OK, body = String, content_type = "text/csv", headers(("content-disposition" = String, description = "attachment with its file name")))))]
async fn get_results_file(State(app): State<AppState>, Path(run): Path<i64>) -> Result<Response, Problem> {
    let run = RunId(run);
    let file = app.read_journal(move |journal| journal.load_run(run).map(|stored| run_files::results_file(&stored)));
    let table = file.await??.map_err(|error| unwritable_file_problem(&error))?;
    let table = table.ok_or(ReportError::NoEstimate(run))?;
    Ok(attachment(CSV_CONTENT_TYPE, &run_files::results_file_name(run), table))
}

/// Response that the browser saves as a file. `file_name`: only letters, digits, `-` and `.`, so that it needs no
/// escaping.
pub(super) fn attachment(content_type: &'static str, file_name: &str, content: Vec<u8>) -> Response {
    let disposition = format!("attachment; filename=\"{file_name}\"");
    ([(CONTENT_TYPE, content_type.to_owned()), (CONTENT_DISPOSITION, disposition)], content).into_response()
}

fn unwritable_file_problem(error: &dyn std::error::Error) -> Problem {
    let (status, remedy) = (StatusCode::INTERNAL_SERVER_ERROR, "report the error as a defect of trued");
    Problem::new(status, "no-file", format!("the file cannot be written: {error}"), remedy)
}
