//! What can be read: machines, runs, plans, readings by pages, estimates, trends.

use std::sync::Arc;

use axum::extract::{Path, Query, State};
use axum::routing::get;
use axum::{Json, Router};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::Web;
use super::problem::Problem;
use super::standing::Standing;
use crate::archive::history::{Series, history};
use crate::archive::story::story;
use crate::record::estimate::Estimate;
use crate::record::plan::Plan;
use crate::record::reading::Reading;
use crate::store::{Audit, Journal, RunId, RunSummary, StoreError};

/// Of a list, unless asked for less.
const PAGE: usize = 200;

pub fn routes() -> Router<Web> {
    Router::new()
        .route("/api/v1/machines", get(machines))
        .route("/api/v1/machines/{name}", get(machine))
        .route("/api/v1/machines/{name}/trends", get(trends))
        .route("/api/v1/audit", get(audit))
        .route("/api/v1/runs", get(runs))
        .route("/api/v1/runs/{run}", get(run))
        .route("/api/v1/runs/{run}/plan", get(plan))
        .route("/api/v1/runs/{run}/readings", get(readings))
        .route("/api/v1/runs/{run}/estimate", get(estimate))
}

/// Beside the thread that answers: the disk may be slow.
pub(super) async fn look<T: Send + 'static>(
    web: &Web,
    read: impl FnOnce(&Journal) -> T + Send + 'static,
) -> Result<T, Problem> {
    let journal = Arc::clone(&web.journal);
    tokio::task::spawn_blocking(move || read(&journal)).await.map_err(|_| {
        let status = axum::http::StatusCode::INTERNAL_SERVER_ERROR;
        Problem::new(status, "no-answer", "the question ended without answer", "ask again")
    })
}

async fn machines(State(web): State<Web>) -> Json<Vec<Standing>> {
    Json(web.machines.iter().map(Standing::of).collect())
}

async fn machine(
    State(web): State<Web>,
    Path(name): Path<String>,
) -> Result<Json<Standing>, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    Ok(Json(Standing::of(machine)))
}

async fn trends(
    State(web): State<Web>,
    Path(name): Path<String>,
) -> Result<Json<Vec<Series>>, Problem> {
    Ok(Json(look(&web, move |journal| history(journal, &name)).await??))
}

/// Of a list: at most so many, after or before what.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Slice {
    /// Runs: older than this one.
    before: Option<i64>,
    /// Readings: without the first so many.
    after: Option<usize>,
    limit: Option<usize>,
}

impl Slice {
    fn limit(&self) -> usize {
        self.limit.unwrap_or(PAGE).min(PAGE)
    }
}

/// Newest first.
async fn runs(
    State(web): State<Web>,
    Query(slice): Query<Slice>,
) -> Result<Json<Vec<RunSummary>>, Problem> {
    let mut all = look(&web, Journal::runs).await??;
    all.reverse();
    let older = all.into_iter().filter(|run| slice.before.is_none_or(|before| run.id.0 < before));
    Ok(Json(older.take(slice.limit()).collect()))
}

#[derive(Debug, Serialize)]
struct Audited {
    at: Timestamp,
    #[serde(flatten)]
    audit: Audit,
}

/// Newest first.
async fn audit(
    State(web): State<Web>,
    Query(slice): Query<Slice>,
) -> Result<Json<Vec<Audited>>, Problem> {
    let all = look(&web, Journal::audits).await??.into_iter().rev();
    Ok(Json(all.map(|(at, audit)| Audited { at, audit }).take(slice.limit()).collect()))
}

#[derive(Debug, Serialize)]
struct OneRun {
    #[serde(flatten)]
    summary: RunSummary,
    stages: usize,
    steps: usize,
    readings: usize,
    /// When, and what.
    story: Vec<(String, String)>,
}

async fn run(State(web): State<Web>, Path(run): Path<i64>) -> Result<Json<OneRun>, Problem> {
    let stored = look(&web, move |journal| journal.load(RunId(run))).await??;
    Ok(Json(OneRun {
        stages: stored.stages.len(),
        steps: stored.plan.steps.len(),
        readings: stored.readings.len(),
        story: story(&stored),
        summary: stored.summary,
    }))
}

async fn plan(State(web): State<Web>, Path(run): Path<i64>) -> Result<Json<Plan>, Problem> {
    Ok(Json(look(&web, move |journal| journal.load(RunId(run))).await??.plan))
}

#[derive(Debug, Serialize)]
struct Readings {
    all: usize,
    after: usize,
    readings: Vec<Reading>,
}

async fn readings(
    State(web): State<Web>,
    Path(run): Path<i64>,
    Query(slice): Query<Slice>,
) -> Result<Json<Readings>, Problem> {
    let all = look(&web, move |journal| journal.load(RunId(run))).await??.readings;
    let after = slice.after.unwrap_or(0);
    let (count, some) = (all.len(), all.into_iter().skip(after).take(slice.limit()));
    Ok(Json(Readings { all: count, after, readings: some.collect() }))
}

/// The last one.
async fn estimate(State(web): State<Web>, Path(run): Path<i64>) -> Result<Json<Estimate>, Problem> {
    let read = move |journal: &Journal| -> Result<Option<Estimate>, StoreError> {
        Ok(journal.load(RunId(run))?.estimates.pop().map(|stored| stored.estimate))
    };
    let found = look(&web, read).await??;
    found.map(Json).ok_or_else(|| Problem::not_found(format!("estimate of run {run}")))
}
