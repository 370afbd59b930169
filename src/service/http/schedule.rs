//! Schedule: the next times, the outcome of the last slots, and the arming for unattended starts.

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::middleware::from_fn;
use axum::response::{IntoResponse, Redirect, Response};
use jiff::Timestamp;
use serde::Deserialize;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::actions::{ActionRequest, audit_entry, run_to_completion, truncate_reason};
use super::openapi::schemas::AgendaSchema;
use super::page::{errors_as_pages, machine_page_path};
use super::problem::Problem;
use super::{AppState, ServedMachine};
use crate::service::machine_state::Refusal;
use crate::service::not_started::NotStartedReason;
use crate::service::schedule_state::{Agenda, load_agenda, new_arming};

pub fn schedule_routes() -> OpenApiRouter<AppState> {
    let action_routes =
        OpenApiRouter::new().routes(routes!(arm_cycle)).routes(routes!(disarm_cycles)).routes(routes!(report_due));
    // Errors of the form actions are answered as pages, not as JSON.
    OpenApiRouter::new().routes(routes!(get_schedule)).merge(action_routes.layer(from_fn(errors_as_pages)))
}

/// Schedule of a machine: the next times, the armings, and the outcome of the last slots, newest first.
#[utoipa::path(get, path = "/api/v1/machines/{name}/schedule", operation_id = "schedule", params(("name" = String, Path)), responses((status = OK, body = AgendaSchema)))]
async fn get_schedule(State(app): State<AppState>, machine: ServedMachine) -> Result<Json<Agenda>, Problem> {
    Ok(Json(query_agenda(&app, &machine).await?))
}

async fn query_agenda(app: &AppState, machine: &ServedMachine) -> Result<Agenda, Problem> {
    let (planned, name) = (machine.gate.machine_state().planned_schedules, machine.name.clone());
    Ok(app.read_journal(move |journal| load_agenda(journal, planned, &name)).await??)
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
#[utoipa::path(post, path = "/api/v1/machines/{name}/arm", operation_id = "arm", params(("name" = String, Path)), request_body = ArmRequest, responses((status = ACCEPTED, body = AgendaSchema)))]
async fn arm_cycle(action: ActionRequest<ArmRequest>) -> Result<Response, Problem> {
    let ArmRequest { cycle, who, until, why } = &action.body;
    let (machine, who) = (&action.machine, action.caller.audit_name(who)?);
    if !machine.gate.config.cycles.iter().any(|known| known.number == *cycle) {
        return Err(Refusal::NoSuchCycle.into());
    }
    let now = Timestamp::now();
    let arming = new_arming(&machine.name, *cycle, &who, &truncate_reason(why), until, now).map_err(|why| {
        let remedy = "state the end of the arming, for example 14d or 2027-01-31T18:00:00+01:00";
        Problem::new(StatusCode::BAD_REQUEST, "until", why, remedy)
    })?;
    action.app.journal.arm_cycle(&arming).await?;
    respond_with_agenda(&action).await
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
#[utoipa::path(post, path = "/api/v1/machines/{name}/disarm", operation_id = "disarm", params(("name" = String, Path)), request_body = DisarmRequest, responses((status = ACCEPTED, body = AgendaSchema)))]
async fn disarm_cycles(action: ActionRequest<DisarmRequest>) -> Result<Response, Problem> {
    let DisarmRequest { cycle, who, why } = &action.body;
    let (machine, who) = (&action.machine.name, action.caller.audit_name(who)?);
    action.app.journal.disarm_cycles(machine, *cycle, &who, &truncate_reason(why)).await?;
    respond_with_agenda(&action).await
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
#[utoipa::path(post, path = "/api/v1/machines/{name}/due", operation_id = "due", params(("name" = String, Path)), request_body = DueCycleRequest, responses((status = ACCEPTED, body = AgendaSchema)))]
async fn report_due(action: ActionRequest<DueCycleRequest>) -> Result<Response, Problem> {
    let who = action.caller.audit_name(&action.body.who)?;
    let action =
        run_to_completion(async move { start_due_cycle_and_audit(&action, who).await.map(|()| action) }).await?;
    respond_with_agenda(&action).await
}

/// Requests the start from the scheduler, waits for its decision, and writes the decision to the audit log.
async fn start_due_cycle_and_audit(action: &ActionRequest<DueCycleRequest>, who: String) -> Result<(), Problem> {
    let (machine, DueCycleRequest { cycle, why, .. }) = (&action.machine, &action.body);
    let result = match machine.gate.start_due_cycle(*cycle, who.clone()) {
        Some(receiver) => receiver.await.unwrap_or_else(|_| Err(Refusal::NotReady.into())),
        None => Err(Refusal::NotReady.into()),
    };
    let audit = audit_entry(machine, who, format!("cycle {cycle} is due"), why, &result);
    action.app.journal.add_audit_entry(&audit).await?;
    result.map_err(|why: NotStartedReason| {
        let remedy = "the schedule records the cycle as skipped; remove the cause, then repeat the request";
        Problem::new(StatusCode::CONFLICT, "not-started", why.to_string(), remedy)
    })
}

/// Response to an accepted action: a redirect for a form, the schedule for a program.
async fn respond_with_agenda<T>(action: &ActionRequest<T>) -> Result<Response, Problem> {
    let ActionRequest { app, machine, is_form, .. } = action;
    Ok(match is_form {
        true => Redirect::to(&machine_page_path(&machine.name)).into_response(),
        false => (StatusCode::ACCEPTED, Json(query_agenda(app, machine).await?)).into_response(),
    })
}
