//! Schedule: the next times, the outcome of the last slots, and the arming for unattended starts.

use axum::Json;
use axum::extract::{Extension, Path, State};
use axum::http::StatusCode;
use axum::middleware::from_fn;
use axum::response::{IntoResponse, Redirect, Response};
use jiff::Timestamp;
use serde::Deserialize;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::access::Caller;
use super::actions::{JsonOrForm, run_to_completion, truncate_reason};
use super::journal::read_journal;
use super::openapi::views::AgendaView;
use super::page::errors_as_pages;
use super::problem::Problem;
use super::{AppState, ServedMachine};
use crate::service::machine_state::Refusal;
use crate::service::not_started::NotStarted;
use crate::service::schedule_state::{Agenda, agenda, arming};
use crate::store::AuditEntry;

pub fn schedule_routes() -> OpenApiRouter<AppState> {
    let action_routes =
        OpenApiRouter::new().routes(routes!(arm_cycle)).routes(routes!(disarm_cycles)).routes(routes!(report_due));
    // A person who submits an invalid form gets the error as a page.
    OpenApiRouter::new().routes(routes!(get_schedule)).merge(action_routes.layer(from_fn(errors_as_pages)))
}

/// Schedule of a machine: the next times, the armings, and the outcome of the last slots, newest first.
#[utoipa::path(get, path = "/api/v1/machines/{name}/schedule", operation_id = "schedule", params(("name" = String, Path)), responses((status = OK, body = AgendaView)))]
async fn get_schedule(State(app): State<AppState>, Path(name): Path<String>) -> Result<Json<Agenda>, Problem> {
    let machine = app.find_machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    Ok(Json(read_agenda(&app, machine).await?))
}

async fn read_agenda(app: &AppState, machine: &ServedMachine) -> Result<Agenda, Problem> {
    let (planned, name) = (machine.gate.machine_state().planned, machine.name.clone());
    Ok(read_journal(app, move |journal| agenda(journal, planned, &name)).await??)
}

#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct ArmRequest {
    cycle: u16,
    who: String,
    /// An instant, or a duration from now: `14d`.
    until: String,
    #[serde(default)]
    why: String,
}

/// Arm a cycle: it may start unattended at its scheduled times, until the given instant.
#[utoipa::path(post, path = "/api/v1/machines/{name}/arm", operation_id = "arm", params(("name" = String, Path)), request_body = ArmRequest, responses((status = ACCEPTED, body = AgendaView)))]
async fn arm_cycle(
    State(app): State<AppState>,
    Path(name): Path<String>,
    Extension(caller): Extension<Caller>,
    body: JsonOrForm<ArmRequest>,
) -> Result<Response, Problem> {
    let machine = app.find_machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let (ArmRequest { cycle, who, until, why }, is_form) = body.into_parts();
    let who = caller.audit_name(&who)?;
    if !machine.cycles.iter().any(|known| known.number == cycle) {
        return Err(Refusal::NoSuchCycle.into());
    }
    let now = Timestamp::now();
    let arming = arming(&name, cycle, &who, &truncate_reason(&why), &until, now).map_err(|why| {
        let remedy = "state the end of the arming, for example 14d or 2027-01-31T18:00:00+01:00";
        Problem::new(StatusCode::BAD_REQUEST, "until", why.to_string(), remedy)
    })?;
    app.journal.arm(&arming).await?;
    respond(&app, machine, is_form).await
}

#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct DisarmRequest {
    /// Cycle to disarm; all cycles if absent.
    cycle: Option<u16>,
    who: String,
    #[serde(default)]
    why: String,
}

/// Disarm cycles: they no longer start unattended.
#[utoipa::path(post, path = "/api/v1/machines/{name}/disarm", operation_id = "disarm", params(("name" = String, Path)), request_body = DisarmRequest, responses((status = ACCEPTED, body = AgendaView)))]
async fn disarm_cycles(
    State(app): State<AppState>,
    Path(name): Path<String>,
    Extension(caller): Extension<Caller>,
    body: JsonOrForm<DisarmRequest>,
) -> Result<Response, Problem> {
    let machine = app.find_machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let (DisarmRequest { cycle, who, why }, is_form) = body.into_parts();
    app.journal.disarm(&name, cycle, &caller.audit_name(&who)?, &truncate_reason(&why)).await?;
    respond(&app, machine, is_form).await
}

#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct DueCycleRequest {
    cycle: u16,
    who: String,
    #[serde(default)]
    why: String,
}

/// Report that a cycle is due now. It starts once, under the conditions of the schedule: armed and ready.
#[utoipa::path(post, path = "/api/v1/machines/{name}/due", operation_id = "due", params(("name" = String, Path)), request_body = DueCycleRequest, responses((status = ACCEPTED, body = AgendaView)))]
async fn report_due(
    State(app): State<AppState>,
    Path(name): Path<String>,
    Extension(caller): Extension<Caller>,
    body: JsonOrForm<DueCycleRequest>,
) -> Result<Response, Problem> {
    let machine = app.find_machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let (due, is_form) = body.into_parts();
    let due = DueCycleRequest { who: caller.audit_name(&due.who)?, ..due };
    run_to_completion(request_due_start(app.clone(), machine.clone(), due)).await?;
    respond(&app, machine, is_form).await
}

async fn request_due_start(app: AppState, machine: ServedMachine, due: DueCycleRequest) -> Result<(), Problem> {
    let DueCycleRequest { cycle, who, why } = due;
    let result = match machine.gate.request_due(cycle, who.clone()) {
        Some(receiver) => receiver.await.unwrap_or_else(|_| Err(NotStarted::Refused(Refusal::NotReady))),
        None => Err(NotStarted::Refused(Refusal::NotReady)),
    };
    let outcome = match &result {
        Ok(()) => "accepted".to_owned(),
        Err(why) => format!("refused: {why}"),
    };
    let (what, run) = (format!("cycle {cycle} is due"), machine.gate.machine_state().run.into());
    let audit = AuditEntry { who, what, why: truncate_reason(&why), machine: machine.name, run, outcome };
    app.journal.add_audit_entry(&audit).await?;
    result.map_err(|why| {
        let remedy = "the schedule records the cycle as skipped; remove the cause, then repeat the request";
        Problem::new(StatusCode::CONFLICT, "not-started", why.to_string(), remedy)
    })
}

async fn respond(app: &AppState, machine: &ServedMachine, is_form: bool) -> Result<Response, Problem> {
    Ok(match is_form {
        true => Redirect::to(&super::page::machine_page_path(&machine.name)).into_response(),
        false => (StatusCode::ACCEPTED, Json(read_agenda(app, machine).await?)).into_response(),
    })
}
