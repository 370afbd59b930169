//! Read access: machines, runs, plans, readings by pages, estimates, trends.

use axum::Json;
use axum::extract::{Path, Query, State};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::machine_status::MachineStatus;
use super::openapi::schemas::{AuditSchema, ComparisonSchema, DocumentedObject, RunSchema, SeriesView};
use super::problem::Problem;
use super::run_list_query::{RunListQuery, item_limit};
use super::{AppState, ServedMachine};
use crate::archive::compare::{RunComparison, compare_runs};
use crate::archive::history::{ParameterSeries, machine_history};
use crate::archive::run_story::describe_events_with_times;
use crate::store::{RunId, RunSummary, StoredAuditEntry};
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::record::reading::Reading;

pub fn api_routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        .routes(routes!(list_machines))
        .routes(routes!(get_machine))
        .routes(routes!(get_trends))
        .routes(routes!(list_audit_log))
        .routes(routes!(list_runs))
        .routes(routes!(get_run))
        .routes(routes!(get_plan))
        .routes(routes!(list_readings))
        .routes(routes!(get_estimate))
        .routes(routes!(get_comparison))
}

/// State of all machines.
#[utoipa::path(get, path = "/api/v1/machines", operation_id = "machines", responses((status = OK, body = Vec<MachineStatus>)))]
async fn list_machines(State(app): State<AppState>) -> Json<Vec<MachineStatus>> {
    Json(app.machines.iter().map(MachineStatus::from_machine).collect())
}

/// State of a machine.
#[utoipa::path(get, path = "/api/v1/machines/{name}", operation_id = "machine", params(("name" = String, Path)), responses((status = OK, body = MachineStatus)))]
async fn get_machine(machine: ServedMachine) -> Json<MachineStatus> {
    Json(MachineStatus::from_machine(&machine))
}

/// Series of each parameter over the newest 200 finished runs of its method: values, tolerance, mean temperatures of
/// each run, control limits, steps and drifts.
#[utoipa::path(get, path = "/api/v1/machines/{name}/trends", operation_id = "trends", params(("name" = String, Path)), responses((status = OK, body = Vec<SeriesView>)))]
async fn get_trends(
    State(app): State<AppState>,
    Path(name): Path<String>,
) -> Result<Json<Vec<ParameterSeries>>, Problem> {
    // A machine that is no longer served has no tolerances, but may still have runs in the journal.
    let tolerances = app.find_machine(&name).map(|machine| machine.machine_file.tolerances.clone()).ok();
    let series =
        app.read_journal(move |journal| match tolerances.is_some() || journal.machine_names()?.contains(&name) {
            true => Ok(machine_history(journal, &name, &tolerances.unwrap_or_default())?),
            false => Err(Problem::not_found(&name)),
        });
    Ok(Json(series.await??))
}

/// Range of entries of the audit log.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
struct AuditListQuery {
    /// Only entries before the one with this `seq`.
    before: Option<i64>,
    limit: Option<usize>,
}

/// Range of readings.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
struct ReadingListQuery {
    /// Number of readings to skip.
    after: Option<usize>,
    limit: Option<usize>,
}

/// Runs, newest first.
#[utoipa::path(get, path = "/api/v1/runs", operation_id = "runs", params(RunListQuery), responses((status = OK, body = Vec<RunSchema>)))]
async fn list_runs(
    State(app): State<AppState>,
    Query(query): Query<RunListQuery>,
) -> Result<Json<Vec<RunSummary>>, Problem> {
    Ok(Json(app.read_journal(move |journal| journal.list_runs(query.filter(), query.item_limit())).await??))
}

/// Audit log: requests, who made them, and their outcome, newest first.
#[utoipa::path(get, path = "/api/v1/audit", operation_id = "audit", params(AuditListQuery), responses((status = OK, body = Vec<AuditSchema>)))]
async fn list_audit_log(
    State(app): State<AppState>,
    Query(AuditListQuery { before, limit }): Query<AuditListQuery>,
) -> Result<Json<Vec<StoredAuditEntry>>, Problem> {
    Ok(Json(app.read_journal(move |journal| journal.audit_entries(before, item_limit(limit))).await??))
}

#[derive(Debug, Serialize, ToSchema)]
struct RunDetail {
    #[serde(flatten)]
    #[schema(value_type = RunSchema)]
    summary: RunSummary,
    stages: usize,
    steps: usize,
    readings: usize,
    /// Time and text of each event.
    #[schema(value_type = Vec<Vec<String>>)]
    story: Vec<(String, String)>,
}

/// A run and its events.
#[utoipa::path(get, path = "/api/v1/runs/{run}", operation_id = "run", params(("run" = i64, Path)), responses((status = OK, body = RunDetail)))]
async fn get_run(State(app): State<AppState>, Path(run): Path<i64>) -> Result<Json<RunDetail>, Problem> {
    let stored = app.read_journal(move |journal| journal.load_run(RunId(run))).await??;
    Ok(Json(RunDetail {
        stages: stored.stages.len(),
        steps: stored.plan.steps.len(),
        readings: stored.readings.len(),
        story: describe_events_with_times(&stored).into_iter().map(|(at, text)| (format!("{at:.0}"), text)).collect(),
        summary: stored.summary,
    }))
}

/// Plan of a run, as `trued export` writes it.
#[utoipa::path(get, path = "/api/v1/runs/{run}/plan", operation_id = "plan", params(("run" = i64, Path)), responses((status = OK, body = DocumentedObject)))]
async fn get_plan(State(app): State<AppState>, Path(run): Path<i64>) -> Result<Json<Plan>, Problem> {
    Ok(Json(app.read_journal(move |journal| journal.load_run(RunId(run))).await??.plan))
}

#[derive(Debug, Serialize, ToSchema)]
struct ReadingsPage {
    all: usize,
    after: usize,
    #[schema(value_type = Vec<DocumentedObject>)]
    readings: Vec<Reading>,
}

/// Readings of a run, without the first `after`.
#[utoipa::path(get, path = "/api/v1/runs/{run}/readings", operation_id = "readings", params(("run" = i64, Path), ReadingListQuery), responses((status = OK, body = ReadingsPage)))]
async fn list_readings(
    State(app): State<AppState>,
    Path(run): Path<i64>,
    Query(range): Query<ReadingListQuery>,
) -> Result<Json<ReadingsPage>, Problem> {
    let (after, most) = (range.after.unwrap_or(0), item_limit(range.limit));
    let query = app.read_journal(move |journal| journal.count_and_list_readings(RunId(run), after, most));
    let (all, readings) = query.await??;
    Ok(Json(ReadingsPage { all, after, readings }))
}

/// Last estimate of a run, as `trued export` writes it.
#[utoipa::path(get, path = "/api/v1/runs/{run}/estimate", operation_id = "estimate", params(("run" = i64, Path)), responses((status = OK, body = DocumentedObject)))]
async fn get_estimate(State(app): State<AppState>, Path(run): Path<i64>) -> Result<Json<Estimate>, Problem> {
    let mut stored = app.read_journal(move |journal| journal.load_run(RunId(run))).await??;
    let last = stored.estimates.pop().ok_or_else(|| Problem::not_found(format!("estimate of run {run}")))?;
    Ok(Json(last.estimate))
}

/// Runs to compare.
#[derive(Debug, Clone, Copy, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
pub(super) struct RunPair {
    a: i64,
    b: i64,
}

/// Difference of run `b` from run `a`: each value's and each function's, with its expanded uncertainty and E_n.
#[utoipa::path(get, path = "/api/v1/compare", operation_id = "compared", params(RunPair), responses((status = OK, body = ComparisonSchema)))]
async fn get_comparison(
    State(app): State<AppState>,
    Query(pair): Query<RunPair>,
) -> Result<Json<RunComparison>, Problem> {
    Ok(Json(compare_pair(&app, pair).await?))
}

/// Comparison of two runs; the web page uses it too.
pub(super) async fn compare_pair(app: &AppState, RunPair { a, b }: RunPair) -> Result<RunComparison, Problem> {
    Ok(app.read_journal(move |journal| compare_runs(journal, RunId(a), RunId(b))).await??)
}
