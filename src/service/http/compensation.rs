//! Compensation: values for the control of a machine, proposed from a run; a metrologist approves them.

use axum::Json;
use axum::extract::{Extension, Path, Query, State};
use axum::http::StatusCode;
use axum::middleware::from_fn;
use axum::response::{IntoResponse, Redirect, Response};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::access::Caller;
use super::actions::{ActionRequest, JsonOrFormBody, audit_entry};
use super::openapi::schemas::DocumentedObject;
use super::page::{errors_as_pages, machine_page_path};
use super::problem::Problem;
use super::run_files::{CSV_CONTENT_TYPE, attachment};
use super::{AppState, MAX_RESPONSE_TIME, ServedMachine};
use crate::compensation::{
    CompensationError, CompensationStatus, HashedProposal, MachineCompensation, ProposalSource, Verification,
    render_correction_sheet,
};
use crate::service::machine_state::Refusal;
use crate::service::worker_command::CompensationResultReceiver;
use crate::store::{MachineLock, RunId};
use methods::compensation::ProposalOptions;

pub fn compensation_routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        .routes(routes!(write_compensation))
        .routes(routes!(verify_compensation))
        .routes(routes!(undo_compensation))
        .routes(routes!(finish_compensation))
        .layer(from_fn(errors_as_pages))
        .routes(routes!(get_proposal))
        .routes(routes!(get_verification))
        .routes(routes!(get_compensation))
        .routes(routes!(get_sheet_file))
}

/// Options of a proposal, as of `trued compensate propose`.
#[derive(Debug, Clone, Serialize, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
pub(super) struct ProposalQuery {
    /// Key of [compensation] in the machine file, if it has several.
    pub(super) target: Option<String>,
    /// Also change positions that deviate by less than their U.
    #[serde(default)]
    with_insignificant: bool,
    /// Largest change of a position, mm.
    max_change_mm: Option<f64>,
}

impl ProposalQuery {
    /// The run and the options from which the proposal is computed; `target` is not part of them.
    pub(super) fn source(&self, run: i64) -> ProposalSource {
        let options = ProposalOptions {
            applies_insignificant_changes: self.with_insignificant,
            max_change_mm: self.max_change_mm.unwrap_or(ProposalOptions::DEFAULT_MAX_CHANGE_MM),
        };
        ProposalSource { run: RunId(run), options }
    }
}

#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
pub(super) struct TargetQuery {
    /// Key of [compensation] in the machine file, if it has several.
    pub(super) target: Option<String>,
}

#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct WriteCompensationRequest {
    who: String,
    /// SHA-256 of the proposal that this person has read.
    approve: String,
    /// As in the request for the proposal.
    #[serde(default)]
    with_insignificant: bool,
    max_change_mm: Option<f64>,
    target: Option<String>,
}

#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct CompensationDecision {
    who: String,
    /// Key of [compensation] in the machine file, if it has several.
    target: Option<String>,
}

/// Number of a compensation. Absent: the values are still being written, because the control is slow; the page of the
/// machine and the audit log will show the result.
#[derive(Debug, Serialize, ToSchema)]
struct CompensationNumber {
    #[serde(skip_serializing_if = "Option::is_none")]
    id: Option<i64>,
}

/// Values for the control, proposed from a run. Writes nothing to the control.
#[utoipa::path(get, path = "/api/v1/runs/{run}/compensation", operation_id = "proposal", params(("run" = i64, Path), ProposalQuery), responses((status = OK, body = DocumentedObject)))]
async fn get_proposal(
    State(app): State<AppState>,
    Extension(caller): Extension<Caller>,
    Path(run): Path<i64>,
    Query(query): Query<ProposalQuery>,
) -> Result<Json<HashedProposal>, Problem> {
    let machine = app.machine_of_run(run).await?;
    let source = query.source(run);
    Ok(Json(app.read_control(&caller, &machine, query.target, move |compensation| compensation.propose(source)).await?))
}

/// Write the proposed values to the control and read them back. A metrologist approves the hash of the proposal.
#[utoipa::path(post, path = "/api/v1/runs/{run}/compensation", operation_id = "compensate", params(("run" = i64, Path)), request_body = WriteCompensationRequest, responses((status = CREATED, body = CompensationNumber), (status = ACCEPTED, body = CompensationNumber)))]
async fn write_compensation(
    State(app): State<AppState>,
    Path(run): Path<i64>,
    Extension(caller): Extension<Caller>,
    JsonOrFormBody { body, is_form }: JsonOrFormBody<WriteCompensationRequest>,
) -> Result<Response, Problem> {
    let machine = app.machine_of_run(run).await?;
    let WriteCompensationRequest { who, approve, with_insignificant, max_change_mm, target } = body;
    let query = ProposalQuery { target, with_insignificant, max_change_mm };
    let source = query.source(run);
    let body = CompensationDecision { who, target: query.target };
    let action = ActionRequest { app, machine, caller, body, is_form };
    execute_decision(action, format!("compensation from run {run}"), move |compensation, lock, who| {
        compensation.write(lock, who, source, &approve).map(|(id, _)| id)
    })
    .await
}

/// What the run has measured after the last compensation, against its prediction. Writes nothing.
#[utoipa::path(get, path = "/api/v1/runs/{run}/verification", operation_id = "verification", params(("run" = i64, Path), TargetQuery), responses((status = OK, body = DocumentedObject)))]
async fn get_verification(
    State(app): State<AppState>,
    Extension(caller): Extension<Caller>,
    Path(run): Path<i64>,
    Query(TargetQuery { target }): Query<TargetQuery>,
) -> Result<Json<Verification>, Problem> {
    let machine = app.machine_of_run(run).await?;
    let compare = move |compensation: &MachineCompensation<'_>| compensation.compare_with_prediction(RunId(run));
    Ok(Json(app.read_control(&caller, &machine, target, compare).await?))
}

/// Store the result of the verification by the run.
#[utoipa::path(post, path = "/api/v1/runs/{run}/verification", operation_id = "verify", params(("run" = i64, Path)), request_body = CompensationDecision, responses((status = CREATED, body = CompensationNumber), (status = ACCEPTED, body = CompensationNumber)))]
async fn verify_compensation(
    State(app): State<AppState>,
    Path(run): Path<i64>,
    Extension(caller): Extension<Caller>,
    JsonOrFormBody { body, is_form }: JsonOrFormBody<CompensationDecision>,
) -> Result<Response, Problem> {
    let machine = app.machine_of_run(run).await?;
    let what = format!("verification of the last compensation by run {run}");
    execute_decision(ActionRequest { app, machine, caller, body, is_form }, what, move |compensation, lock, who| {
        compensation.verify(lock, who, RunId(run)).map(|verification| verification.compensation)
    })
    .await
}

/// Values that the control holds, and the last compensation.
#[utoipa::path(get, path = "/api/v1/machines/{name}/compensation", operation_id = "compensation", params(("name" = String, Path), TargetQuery), responses((status = OK, body = DocumentedObject)))]
async fn get_compensation(
    State(app): State<AppState>,
    Extension(caller): Extension<Caller>,
    machine: ServedMachine,
    Query(TargetQuery { target }): Query<TargetQuery>,
) -> Result<Json<CompensationStatus>, Problem> {
    Ok(Json(app.read_control(&caller, &machine, target, |compensation| compensation.status()).await?))
}

/// Restore the values before the last compensation.
#[utoipa::path(post, path = "/api/v1/machines/{name}/compensation/undo", operation_id = "undo", params(("name" = String, Path)), request_body = CompensationDecision, responses((status = CREATED, body = CompensationNumber), (status = ACCEPTED, body = CompensationNumber)))]
async fn undo_compensation(action: ActionRequest<CompensationDecision>) -> Result<Response, Problem> {
    let what = "undo of the last compensation".to_owned();
    execute_decision(action, what, |compensation, lock, who| compensation.undo(lock, who).map(|last| last.id)).await
}

/// Write the rest of a compensation that was interrupted, or confirm that the control was restarted.
#[utoipa::path(post, path = "/api/v1/machines/{name}/compensation/finish", operation_id = "finish", params(("name" = String, Path)), request_body = CompensationDecision, responses((status = CREATED, body = CompensationNumber), (status = ACCEPTED, body = CompensationNumber)))]
async fn finish_compensation(action: ActionRequest<CompensationDecision>) -> Result<Response, Problem> {
    let what = "end of an unfinished compensation".to_owned();
    execute_decision(action, what, |compensation, lock, who| compensation.finish(lock, who).map(|last| last.id)).await
}

/// Measured errors for a control or a CAM system, as `trued compensate sheet` writes them.
#[utoipa::path(get, path = "/api/v1/runs/{run}/sheet.csv", operation_id = "sheet_file", params(("run" = i64, Path)), responses((status = OK, body = String, content_type = "text/csv", headers(("content-disposition" = String, description = "attachment with its file name")))))]
async fn get_sheet_file(State(app): State<AppState>, Path(run): Path<i64>) -> Result<Response, Problem> {
    let sheet = app.read_journal(move |journal| render_correction_sheet(journal, RunId(run))).await?;
    let csv = sheet.map_err(CompensationError::from)?.csv;
    Ok(attachment(CSV_CONTENT_TYPE, &format!("run-{run}-errors.csv"), csv))
}

/// Name of the person who decides, for the audit log. Refused without a token, because the role of the person is then
/// unknown; the role itself was checked for the route.
fn decision_name(caller: &Caller, who: &str) -> Result<String, Problem> {
    match caller.has_token() {
        true => caller.audit_name(who),
        false => Err(Problem::new(
            StatusCode::FORBIDDEN,
            "no-token",
            "without tokens the service cannot verify that a metrologist decides",
            "set `tokens = true` in [serve.http] and add a token with `trued token add`, or use `trued compensate`",
        )),
    }
}

/// Sends the decision `what` of a person to the worker and waits a limited time for its result, the number of the
/// compensation. The result is in the audit log in any case. The last argument of `decide` is the person's name.
async fn execute_decision(
    action: ActionRequest<CompensationDecision>,
    what: String,
    decide: impl FnOnce(&MachineCompensation<'_>, &MachineLock, &str) -> Result<i64, CompensationError> + Send + 'static,
) -> Result<Response, Problem> {
    let ActionRequest { app, machine, caller, body: CompensationDecision { who, target }, is_form } = action;
    let who = decision_name(&caller, &who)?;
    let by = who.clone();
    let accepted = machine.gate.compensate(&what, target, move |compensation, lock| decide(compensation, lock, &by));
    let page = machine_page_path(&machine.name);
    let work = tokio::spawn(await_and_audit(app, machine, who, what, accepted));
    let id = match tokio::time::timeout(MAX_RESPONSE_TIME, work).await {
        Ok(ended) => Some(ended.unwrap_or_else(|_| Err(Refusal::NotReady.into()))?),
        Err(_) => None,
    };
    Ok(match is_form {
        true => Redirect::to(&page).into_response(),
        false => {
            let status = if id.is_some() { StatusCode::CREATED } else { StatusCode::ACCEPTED };
            (status, Json(CompensationNumber { id })).into_response()
        }
    })
}

/// Waits without a time limit for the result of the accepted command, and writes it or the refusal to the audit log.
async fn await_and_audit(
    app: AppState,
    machine: ServedMachine,
    who: String,
    what: String,
    accepted: Result<CompensationResultReceiver<i64>, Refusal>,
) -> Result<i64, Problem> {
    let result = match accepted {
        // An error: the worker has dropped the command, because the service is ending.
        Ok(receiver) => receiver.await.map_err(|_| Problem::from(Refusal::NotReady)).and_then(|id| Ok(id?)),
        Err(why) => Err(Problem::from(why)),
    };
    let outcome = result.as_ref().map(drop).map_err(|problem| &problem.message);
    app.journal.add_audit_entry(&audit_entry(&machine, who, what, "", &outcome)).await?;
    result
}

impl AppState {
    /// The machine that the run measured, if it is served.
    pub(super) async fn machine_of_run(&self, run: i64) -> Result<ServedMachine, Problem> {
        let stored = self.read_journal(move |journal| journal.load_run(RunId(run))).await??;
        self.find_machine(&stored.summary.machine).cloned()
    }
}

impl From<CompensationError> for Problem {
    fn from(error: CompensationError) -> Self {
        let remedy = error.remedy();
        match error {
            CompensationError::Journal(error) => error.into(),
            other => Self::new(StatusCode::CONFLICT, "no-compensation", other.to_string(), remedy),
        }
    }
}
