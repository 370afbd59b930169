//! Actions: start a cycle, hold the machine, acknowledge, resume, answer, sign. Each states the client's name and
//! optionally a reason. Each is written to the audit log before the response, even if the client has disconnected.
//! A program sends JSON; the page sends a form and is redirected to the machine's page.

mod answer;
mod holds;
mod resume;
mod sign;
mod words;

use std::future::Future;
use std::time::Duration;

use axum::Json;
use axum::extract::{Extension, FromRequest, Path, Request, State};
use axum::http::StatusCode;
use axum::middleware::from_fn;
use axum::response::{IntoResponse, Redirect, Response};
use serde::Deserialize;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

pub(super) use self::holds::Holds;
pub(super) use self::words::{JsonOrForm, truncate_reason};
use super::access::Caller;
use super::page::for_people;
use super::problem::Problem;
use super::status::MachineStatus;
use super::{AppState, ServedMachine};
use crate::service::config::Demand;
use crate::service::machine_state::{Interlocks, Refusal};
use crate::service::worker_command::{Answer, Inspection, Stopped};
use crate::store::Audit;

/// Maximum time to receive the body of a hold, after the machine is held.
const PATIENCE: Duration = Duration::from_secs(2);
/// Maximum time to wait until an acknowledgement is in the journal or refused.
const SETTLES: Duration = Duration::from_secs(5);

pub fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        .routes(routes!(start))
        .routes(routes!(hold))
        .routes(routes!(acknowledge))
        .routes(routes!(resume::resume))
        .routes(routes!(answer::done))
        .routes(routes!(sign::sign))
        .layer(from_fn(for_people))
}

#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct Start {
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
struct Asked {
    #[serde(default)]
    who: String,
    #[serde(default)]
    why: String,
}

#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct Seen {
    #[serde(default)]
    who: String,
    #[serde(default)]
    why: String,
    /// Whether all axes are homed; required where the control may have lost its position.
    #[serde(default)]
    homed: bool,
}

/// Start a cycle. The caller confirms the conditions that `[serve]` demands.
#[utoipa::path(post, path = "/api/v1/machines/{name}/start", params(("name" = String, Path)), request_body = Start, responses((status = ACCEPTED, body = MachineStatus)))]
async fn start(
    State(web): State<AppState>,
    Path(name): Path<String>,
    Extension(caller): Extension<Caller>,
    words: JsonOrForm<Start>,
) -> Result<Response, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let (asked, to_page) = words.split();
    let who = caller.signs(&asked.who)?;
    vouched(machine, &asked)?;
    let accepted = machine.gate.start(asked.cycle, said(machine), &who);
    let what = format!("start of cycle {}", asked.cycle);
    answer(&web, machine, (who, what, asked.why), accepted, to_page).await
}

/// Interlocks for a person's request: the person confirms all conditions, but a fresh report of the machine takes
/// precedence.
fn said(machine: &ServedMachine) -> Interlocks {
    let vouched =
        Interlocks { fresh: true, enable: true, auto: true, door: true, stop: false, person: true };
    machine.gate.fresh_interlocks().map_or(vouched, |said| Interlocks { person: true, ..said })
}

fn vouched(machine: &ServedMachine, asked: &Start) -> Result<(), Problem> {
    let missing = machine.demand.iter().find_map(|demand| match demand {
        Demand::Enable if !asked.enable => Some("that the machine is free to be moved (enable)"),
        Demand::Auto if !asked.auto => Some("that the control is in its automatic mode (auto)"),
        Demand::Door if !asked.door => Some("that the guards are closed (door)"),
        _ => None,
    });
    missing.map_or(Ok(()), |what| Err(not_vouched(what)))
}

fn not_vouched(what: &str) -> Problem {
    let message = format!("nobody has vouched {what}");
    Problem::new(StatusCode::CONFLICT, "not-vouched", message, "look at the machine, then say so")
}

/// Hold the machine at once. A known caller is never refused; the body may be missing.
#[utoipa::path(post, path = "/api/v1/machines/{name}/hold", params(("name" = String, Path)), request_body = Asked, responses((status = ACCEPTED, body = MachineStatus)))]
async fn hold(
    State(web): State<AppState>,
    Path(name): Path<String>,
    Extension(caller): Extension<Caller>,
    request: Request,
) -> Result<Response, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    // Before the body is read: the machine is held even if the rest of the request is invalid.
    let stopped = machine.gate.stop(&caller.is_called(""));
    to_the_end(held(web.clone(), machine.clone(), caller, stopped, request)).await
}

async fn held(
    web: AppState,
    machine: ServedMachine,
    caller: Caller,
    stopped: Stopped,
    request: Request,
) -> Result<Response, Problem> {
    let words = tokio::time::timeout(PATIENCE, JsonOrForm::<Asked>::from_request(request, &()));
    let words = words.await.ok().and_then(Result::ok).unwrap_or(JsonOrForm::Json(Asked::default()));
    let (Asked { who, why }, to_page) = words.split();
    let held = match stopped {
        // This service cannot hold motion of another process.
        Stopped::Elsewhere => Err(Refusal::Elsewhere),
        Stopped::Run | Stopped::Nothing => Ok(()),
    };
    let audit = audit(&machine, (caller.is_called(&who), "hold".to_owned(), why), &held);
    if holds::has_a_line(&web, &caller, &audit, stopped) {
        web.journal.audit(&audit).await?;
    }
    held?;
    Ok(answered(&machine, to_page))
}

/// Completes `work` even if the client disconnects, so that every executed action is logged.
pub(super) async fn to_the_end<T: Send + 'static>(
    work: impl Future<Output = Result<T, Problem>> + Send + 'static,
) -> Result<T, Problem> {
    tokio::spawn(work).await.unwrap_or_else(|_| Err(Refusal::NotReady.into()))
}

/// Acknowledge that a person has inspected the machine: new cycles may start.
#[utoipa::path(post, path = "/api/v1/machines/{name}/acknowledge", params(("name" = String, Path)), request_body = Seen, responses((status = ACCEPTED, body = MachineStatus)))]
async fn acknowledge(
    State(web): State<AppState>,
    Path(name): Path<String>,
    Extension(caller): Extension<Caller>,
    words: JsonOrForm<Seen>,
) -> Result<Response, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?.clone();
    let (Seen { who, why, homed }, to_page) = words.split();
    let (who, why) = (caller.signs(&who)?, truncate_reason(&why));
    let accepted = machine.gate.acknowledge(Inspection { who: &who, why: &why, homed });
    let said = (who, "acknowledgement".to_owned(), why);
    settled(web, machine, said, accepted, to_page).await
}

/// Waits for the result and writes it to the audit log, even if the client has disconnected.
async fn settled(
    web: AppState,
    machine: ServedMachine,
    said: (String, String, String),
    accepted: Result<Answer, Refusal>,
    to_page: bool,
) -> Result<Response, Problem> {
    to_the_end(async move {
        let became = match accepted {
            // After the timeout, the machine state shows the result.
            Ok(told) => tokio::time::timeout(SETTLES, told)
                .await
                // The worker has dropped the command, because the service is ending.
                .map_or(Ok(()), |told| told.unwrap_or(Err(Refusal::NotReady))),
            Err(why) => Err(why),
        };
        answer(&web, &machine, said, became, to_page).await
    })
    .await
}

/// Responds after the action is in the audit log.
async fn answer(
    web: &AppState,
    machine: &ServedMachine,
    (who, what, why): (String, String, String),
    accepted: Result<(), Refusal>,
    to_page: bool,
) -> Result<Response, Problem> {
    web.journal.audit(&audit(machine, (who, what, why), &accepted)).await?;
    accepted?;
    Ok(answered(machine, to_page))
}

fn audit(
    machine: &ServedMachine,
    (who, what, why): (String, String, String),
    accepted: &Result<(), Refusal>,
) -> Audit {
    let outcome = match accepted {
        Ok(()) => "accepted".to_owned(),
        Err(refusal) => format!("refused: {refusal}"),
    };
    let (name, run) = (machine.name.clone(), machine.gate.machine_state().run);
    Audit { who, what, why: truncate_reason(&why), machine: name, run: run.into(), outcome }
}

fn answered(machine: &ServedMachine, to_page: bool) -> Response {
    match to_page {
        true => Redirect::to(&super::page::address(&machine.name)).into_response(),
        false => (StatusCode::ACCEPTED, Json(MachineStatus::of(machine))).into_response(),
    }
}
