//! Actions: start a cycle, hold the machine, acknowledge, resume, answer, sign. Each states the client's name and
//! optionally a reason. Each is written to the audit log before the response, even if the client has disconnected.
//! A program sends JSON; the web page sends a form and is redirected to the machine's page.

mod body;
mod hold_log;
mod resume;
mod sign;

use std::fmt::Display;
use std::future::Future;
use std::time::Duration;

use axum::Json;
use axum::extract::{Extension, FromRequest, Request, State};
use axum::http::StatusCode;
use axum::middleware::from_fn;
use axum::response::{IntoResponse, Redirect, Response};
use serde::Deserialize;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

pub(super) use self::body::{ActionRequest, JsonOrFormBody, truncate_reason};
pub(super) use self::hold_log::HoldLog;
use super::access::Caller;
use super::machine_status::MachineStatus;
use super::page::errors_as_pages;
use super::problem::Problem;
use super::{AppState, ServedMachine};
use crate::service::config::StartInterlock;
use crate::service::machine_state::{Interlocks, Refusal};
use crate::service::worker_command::{HoldEffect, Inspection, InspectionResultReceiver};
use crate::store::AuditEntry;

/// Maximum time to receive the body of a hold, after the machine is held.
const HOLD_BODY_TIMEOUT: Duration = Duration::from_secs(2);
/// Maximum time to wait until an acknowledgement, also that of a resume, is in the journal or refused. After that,
/// the response and the audit log report it as accepted.
const ACKNOWLEDGEMENT_TIMEOUT: Duration = Duration::from_secs(5);

pub fn action_routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        .routes(routes!(start_cycle))
        .routes(routes!(hold_machine))
        .routes(routes!(acknowledge_machine))
        .routes(routes!(resume::resume_held_run))
        .routes(routes!(answer_prompt))
        .routes(routes!(sign::sign_result))
        .layer(from_fn(errors_as_pages))
}

#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct StartRequest {
    cycle: u16,
    who: String,
    #[serde(default)]
    why: String,
    /// Conditions that this person has checked at the machine.
    #[serde(default)]
    enable: bool,
    #[serde(default)]
    auto: bool,
    #[serde(default)]
    door: bool,
}

#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct HoldRequest {
    #[serde(default)]
    who: String,
    #[serde(default)]
    why: String,
}

#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct AcknowledgeRequest {
    #[serde(default)]
    who: String,
    #[serde(default)]
    why: String,
    /// Whether all axes are homed; required where the control may have lost its position.
    #[serde(default)]
    homed: bool,
}

#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct AnswerRequest {
    /// Step number of the open prompt; `repeat` is its repeat number, from 0.
    step: u32,
    #[serde(default)]
    repeat: u32,
    who: String,
}

/// Start a cycle. The caller confirms the conditions that `[serve]` demands.
#[utoipa::path(post, path = "/api/v1/machines/{name}/start", operation_id = "start", params(("name" = String, Path)), request_body = StartRequest, responses((status = ACCEPTED, body = MachineStatus)))]
async fn start_cycle(action: ActionRequest<StartRequest>) -> Result<Response, Problem> {
    let StartRequest { cycle, who, why, .. } = &action.body;
    let who = action.caller.audit_name(who)?;
    check_interlocks_confirmed_by_person(&action.machine, &action.body)?;
    let accepted = action.machine.gate.start_cycle(*cycle, interlocks_confirmed_by_person(&action.machine), &who);
    action.audit_and_respond(who, format!("start of cycle {cycle}"), why, accepted).await
}

/// Interlocks for a person's request: the person confirms all conditions, but if the machine has a fresh report, all
/// values of this report apply instead, except that a person for the prompts is always present.
fn interlocks_confirmed_by_person(machine: &ServedMachine) -> Interlocks {
    let confirmed = Interlocks {
        is_fresh: true,
        is_start_enabled: true,
        is_auto_mode: true,
        is_door_closed: true,
        is_stop_set: false,
        has_person_for_prompts: true,
    };
    let reported = machine.gate.combined_fresh_interlocks();
    Interlocks { has_person_for_prompts: true, ..reported.unwrap_or(confirmed) }
}

/// Checks that the request confirms each interlock that `[serve]` demands, whatever the machine reports.
fn check_interlocks_confirmed_by_person(machine: &ServedMachine, request: &StartRequest) -> Result<(), Problem> {
    let missing = machine.gate.config.required_interlocks.iter().find_map(|demand| match demand {
        StartInterlock::Enable if !request.enable => Some("that the machine may move (`enable`)"),
        StartInterlock::Auto if !request.auto => Some("that the control is in automatic mode (`auto`)"),
        StartInterlock::Door if !request.door => Some("that the guards are closed (`door`)"),
        _ => None,
    });
    missing.map_or(Ok(()), |what| Err(not_confirmed_problem(what)))
}

fn not_confirmed_problem(what: &str) -> Problem {
    let message = format!("the request does not confirm {what}");
    Problem::new(StatusCode::CONFLICT, "not-vouched", message, "inspect the machine, then confirm the condition")
}

/// Hold the machine at once. A known caller is never refused; the body may be missing.
#[utoipa::path(post, path = "/api/v1/machines/{name}/hold", operation_id = "hold", params(("name" = String, Path)), request_body = HoldRequest, responses((status = ACCEPTED, body = MachineStatus)))]
async fn hold_machine(
    State(app): State<AppState>,
    machine: ServedMachine,
    Extension(caller): Extension<Caller>,
    request: Request,
) -> Result<Response, Problem> {
    // Before the body is read: the machine is held even if the rest of the request is invalid.
    let effect = machine.gate.hold_machine(&caller.log_name(""));
    run_to_completion(audit_hold_and_respond(app, machine, caller, effect, request)).await
}

async fn audit_hold_and_respond(
    app: AppState,
    machine: ServedMachine,
    caller: Caller,
    effect: HoldEffect,
    request: Request,
) -> Result<Response, Problem> {
    let body = tokio::time::timeout(HOLD_BODY_TIMEOUT, JsonOrFormBody::<HoldRequest>::from_request(request, &()));
    let body = body.await.ok().and_then(Result::ok).unwrap_or_default();
    let JsonOrFormBody { body: HoldRequest { who, why }, is_form } = body;
    let held = match effect {
        // This service cannot hold motion of another process.
        HoldEffect::OtherProcessCannotBeHeld => Err(Refusal::UsedByOtherProgram),
        HoldEffect::RunHeld | HoldEffect::NoRunInProgress => Ok(()),
    };
    let audit = audit_entry(&machine, caller.log_name(&who), "hold".to_owned(), &why, &held);
    if hold_log::gets_own_audit_line(&app, &caller, &audit, effect) {
        app.journal.add_audit_entry(&audit).await?;
    }
    held?;
    Ok(accepted_response(&machine, is_form))
}

/// Completes `work` even if the client disconnects, so that every executed action is logged.
pub(super) async fn run_to_completion<T: Send + 'static>(
    work: impl Future<Output = Result<T, Problem>> + Send + 'static,
) -> Result<T, Problem> {
    tokio::spawn(work).await.unwrap_or_else(|_| Err(Refusal::NotReady.into()))
}

/// Acknowledge that a person has inspected the machine: new cycles may start.
#[utoipa::path(post, path = "/api/v1/machines/{name}/acknowledge", operation_id = "acknowledge", params(("name" = String, Path)), request_body = AcknowledgeRequest, responses((status = ACCEPTED, body = MachineStatus)))]
async fn acknowledge_machine(action: ActionRequest<AcknowledgeRequest>) -> Result<Response, Problem> {
    let AcknowledgeRequest { who, why, homed } = &action.body;
    let (who, why) = (action.caller.audit_name(who)?, truncate_reason(why));
    let accepted = action.machine.gate.acknowledge(Inspection { who: &who, why: &why, is_homed: *homed });
    action.await_audit_and_respond(who, "acknowledgement".to_owned(), why, accepted).await
}

/// Answer the run's prompt: the requested action is done, and the run continues.
/// An answer to any other prompt is refused.
#[utoipa::path(post, path = "/api/v1/machines/{name}/answer", operation_id = "done", params(("name" = String, Path)), request_body = AnswerRequest, responses((status = ACCEPTED, body = MachineStatus)))]
async fn answer_prompt(action: ActionRequest<AnswerRequest>) -> Result<Response, Problem> {
    let AnswerRequest { step, repeat, who } = &action.body;
    let who = action.caller.audit_name(who)?;
    let accepted = action.machine.gate.answer_prompt(*step, *repeat, &who);
    action.audit_and_respond(who, format!("answer to step {step}, pass {}", repeat + 1), "", accepted).await
}

impl<T: Send + Sync + 'static> ActionRequest<T> {
    /// Waits for the worker's result, at most [`ACKNOWLEDGEMENT_TIMEOUT`], and writes it to the audit log, even if
    /// the client has disconnected.
    async fn await_audit_and_respond(
        self,
        who: String,
        what: String,
        why: String,
        accepted: Result<InspectionResultReceiver, Refusal>,
    ) -> Result<Response, Problem> {
        run_to_completion(async move {
            let result = match accepted {
                // After the timeout, the machine state shows the result.
                Ok(receiver) => tokio::time::timeout(ACKNOWLEDGEMENT_TIMEOUT, receiver)
                    .await
                    // The worker has dropped the command, because the service is ending.
                    .map_or(Ok(()), |receiver| receiver.unwrap_or(Err(Refusal::NotReady))),
                Err(why) => Err(why),
            };
            self.audit_and_respond(who, what, &why, result).await
        })
        .await
    }

    /// Responds after the action, accepted or refused, is in the audit log; a refusal is returned as an error.
    async fn audit_and_respond(
        &self,
        who: String,
        what: String,
        why: &str,
        accepted: Result<(), Refusal>,
    ) -> Result<Response, Problem> {
        self.app.journal.add_audit_entry(&audit_entry(&self.machine, who, what, why, &accepted)).await?;
        accepted?;
        Ok(accepted_response(&self.machine, self.is_form))
    }
}

/// Entry for a request to act on `machine`; its run is that of the machine state: the run in progress, or the last one,
/// or 0. `accepted`: result of the request.
pub(super) fn audit_entry(
    machine: &ServedMachine,
    who: String,
    what: String,
    why: &str,
    accepted: &Result<(), impl Display>,
) -> AuditEntry {
    let outcome = match accepted {
        Ok(()) => "accepted".to_owned(),
        Err(refusal) => format!("refused: {refusal}"),
    };
    let (name, run) = (machine.name.clone(), machine.gate.machine_state().run);
    AuditEntry { who, what, why: truncate_reason(why), machine: name, run: run.into(), outcome }
}

fn accepted_response(machine: &ServedMachine, is_form: bool) -> Response {
    match is_form {
        true => Redirect::to(&super::page::machine_page_path(&machine.name)).into_response(),
        false => (StatusCode::ACCEPTED, Json(MachineStatus::from_machine(machine))).into_response(),
    }
}
