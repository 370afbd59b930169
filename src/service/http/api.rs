//! Read access: machines, runs, plans, readings by pages, estimates, trends.

use axum::Json;
use axum::extract::{Path, Query, State};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::AppState;
use super::journal::read_journal;
use super::openapi::views::{AuditView, ComparisonView, Contract, RunView, SeriesView};
use super::problem::Problem;
use super::status::MachineStatus;
use crate::archive::compare::{Comparison, compare};
use crate::archive::history::{Series, history};
use crate::archive::story::story;
use crate::store::{Audited, Journal, RunId, RunSummary, StoreError, Wanted};
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Maximum and default number of items in a list.
const PAGE: usize = 200;

pub fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        .routes(routes!(machines))
        .routes(routes!(machine))
        .routes(routes!(trends))
        .routes(routes!(audit))
        .routes(routes!(runs))
        .routes(routes!(run))
        .routes(routes!(plan))
        .routes(routes!(readings))
        .routes(routes!(estimate))
        .routes(routes!(compared))
}

/// State of all machines.
#[utoipa::path(get, path = "/api/v1/machines", responses((status = OK, body = Vec<MachineStatus>)))]
async fn machines(State(web): State<AppState>) -> Json<Vec<MachineStatus>> {
    Json(web.machines.iter().map(MachineStatus::of).collect())
}

/// State of a machine.
#[utoipa::path(get, path = "/api/v1/machines/{name}", params(("name" = String, Path)), responses((status = OK, body = MachineStatus)))]
async fn machine(
    State(web): State<AppState>,
    Path(name): Path<String>,
) -> Result<Json<MachineStatus>, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    Ok(Json(MachineStatus::of(machine)))
}

/// Each value over the newest 200 finished runs of its method, with its tolerance and the mean temperatures of
/// each run; its control limits, its steps and its drifts.
#[utoipa::path(get, path = "/api/v1/machines/{name}/trends", params(("name" = String, Path)), responses((status = OK, body = Vec<SeriesView>)))]
async fn trends(
    State(web): State<AppState>,
    Path(name): Path<String>,
) -> Result<Json<Vec<Series>>, Problem> {
    let served = web.machine(&name).is_some();
    let limits = web.tolerance(&name);
    let found = read_journal(&web, move |journal| {
        // A machine that is no longer served may still have runs in the journal.
        match served || journal.machines()?.contains(&name) {
            true => Ok(history(journal, &name, &limits)?),
            false => Err(Problem::not_found(&name)),
        }
    });
    Ok(Json(found.await??))
}

/// Range of entries of the audit log.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
struct Earlier {
    /// Only entries before the one with this `seq`.
    before: Option<i64>,
    limit: Option<usize>,
}

/// Range of readings.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
struct Further {
    /// Number of readings to skip.
    after: Option<usize>,
    limit: Option<usize>,
}

/// Number of items to return, at most [`PAGE`].
fn most(limit: Option<usize>) -> usize {
    limit.unwrap_or(PAGE).min(PAGE)
}

/// Range of runs.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
pub(super) struct RunsAsked {
    /// Only runs older than this one.
    before: Option<i64>,
    /// Only runs newer than this one; without `before`, those that follow it directly.
    after: Option<i64>,
    limit: Option<usize>,
}

impl RunsAsked {
    pub(super) fn wanted(&self) -> Wanted<'static> {
        let [before, after] = [self.before, self.after].map(|run| run.map(RunId));
        Wanted { before, after, ..Wanted::default() }
    }

    pub(super) fn most(&self) -> usize {
        most(self.limit)
    }
}

/// Runs, newest first.
#[utoipa::path(get, path = "/api/v1/runs", params(RunsAsked), responses((status = OK, body = Vec<RunView>)))]
async fn runs(
    State(web): State<AppState>,
    Query(asked): Query<RunsAsked>,
) -> Result<Json<Vec<RunSummary>>, Problem> {
    Ok(Json(
        read_journal(&web, move |journal| journal.some_runs(asked.wanted(), asked.most()))
            .await??,
    ))
}

/// Audit log: requests, who made them, and their outcome, newest first.
#[utoipa::path(get, path = "/api/v1/audit", params(Earlier), responses((status = OK, body = Vec<AuditView>)))]
async fn audit(
    State(web): State<AppState>,
    Query(Earlier { before, limit }): Query<Earlier>,
) -> Result<Json<Vec<Audited>>, Problem> {
    Ok(Json(read_journal(&web, move |journal| journal.audits(before, most(limit))).await??))
}

#[derive(Debug, Serialize, ToSchema)]
struct OneRun {
    #[serde(flatten)]
    #[schema(value_type = RunView)]
    summary: RunSummary,
    stages: usize,
    steps: usize,
    readings: usize,
    /// Time and text of each event.
    #[schema(value_type = Vec<Vec<String>>)]
    story: Vec<(String, String)>,
}

/// A run and its events.
#[utoipa::path(get, path = "/api/v1/runs/{run}", params(("run" = i64, Path)), responses((status = OK, body = OneRun)))]
async fn run(State(web): State<AppState>, Path(run): Path<i64>) -> Result<Json<OneRun>, Problem> {
    let stored = read_journal(&web, move |journal| journal.load(RunId(run))).await??;
    Ok(Json(OneRun {
        stages: stored.stages.len(),
        steps: stored.plan.steps.len(),
        readings: stored.readings.len(),
        story: story(&stored),
        summary: stored.summary,
    }))
}

/// Plan of a run, as `trued export` writes it.
#[utoipa::path(get, path = "/api/v1/runs/{run}/plan", params(("run" = i64, Path)), responses((status = OK, body = Contract)))]
async fn plan(State(web): State<AppState>, Path(run): Path<i64>) -> Result<Json<Plan>, Problem> {
    Ok(Json(read_journal(&web, move |journal| journal.load(RunId(run))).await??.plan))
}

#[derive(Debug, Serialize, ToSchema)]
struct Readings {
    all: usize,
    after: usize,
    #[schema(value_type = Vec<Contract>)]
    readings: Vec<Reading>,
}

/// Readings of a run, without the first `after`.
#[utoipa::path(get, path = "/api/v1/runs/{run}/readings", params(("run" = i64, Path), Further), responses((status = OK, body = Readings)))]
async fn readings(
    State(web): State<AppState>,
    Path(run): Path<i64>,
    Query(slice): Query<Further>,
) -> Result<Json<Readings>, Problem> {
    let (after, most) = (slice.after.unwrap_or(0), most(slice.limit));
    let some = read_journal(&web, move |journal| journal.some_readings(RunId(run), after, most));
    let (all, readings) = some.await??;
    Ok(Json(Readings { all, after, readings }))
}

/// Last estimate of a run, as `trued export` writes it.
#[utoipa::path(get, path = "/api/v1/runs/{run}/estimate", params(("run" = i64, Path)), responses((status = OK, body = Contract)))]
async fn estimate(
    State(web): State<AppState>,
    Path(run): Path<i64>,
) -> Result<Json<Estimate>, Problem> {
    let read = move |journal: &Journal| -> Result<Option<Estimate>, StoreError> {
        Ok(journal.load(RunId(run))?.estimates.pop().map(|stored| stored.estimate))
    };
    let found = read_journal(&web, read).await??;
    found.map(Json).ok_or_else(|| Problem::not_found(format!("estimate of run {run}")))
}

/// Runs to compare.
#[derive(Debug, Clone, Copy, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
pub(super) struct Pair {
    a: i64,
    b: i64,
}

/// Difference of run `b` from run `a`: each value's and each function's, with its expanded uncertainty and E_n.
#[utoipa::path(get, path = "/api/v1/compare", params(Pair), responses((status = OK, body = ComparisonView)))]
async fn compared(
    State(web): State<AppState>,
    Query(pair): Query<Pair>,
) -> Result<Json<Comparison>, Problem> {
    Ok(Json(of_two(&web, pair).await?))
}

/// Comparison of two runs; the page uses it too.
pub(super) async fn of_two(web: &AppState, Pair { a, b }: Pair) -> Result<Comparison, Problem> {
    Ok(read_journal(web, move |journal| compare(journal, RunId(a), RunId(b))).await??)
}
