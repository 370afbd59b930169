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
use super::actions::{JsonOrForm, to_the_end, truncate_reason};
use super::journal::read_journal;
use super::openapi::views::AgendaView;
use super::page::for_people;
use super::problem::Problem;
use super::{AppState, ServedMachine};
use crate::service::machine_state::Refusal;
use crate::service::schedule_state::{Agenda, agenda, arming};
use crate::store::Audit;

pub fn routes() -> OpenApiRouter<AppState> {
    let done =
        OpenApiRouter::new().routes(routes!(arm)).routes(routes!(disarm)).routes(routes!(due));
    // A person who submits an invalid form gets the error as a page.
    OpenApiRouter::new().routes(routes!(schedule)).merge(done.layer(from_fn(for_people)))
}

/// Schedule of a machine: the next times, the armings, and the outcome of the last slots, newest first.
#[utoipa::path(get, path = "/api/v1/machines/{name}/schedule", params(("name" = String, Path)), responses((status = OK, body = AgendaView)))]
async fn schedule(
    State(web): State<AppState>,
    Path(name): Path<String>,
) -> Result<Json<Agenda>, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    Ok(Json(of(&web, machine).await?))
}

async fn of(web: &AppState, machine: &ServedMachine) -> Result<Agenda, Problem> {
    let (planned, name) = (machine.gate.machine_state().planned, machine.name.clone());
    Ok(read_journal(web, move |journal| agenda(journal, planned, &name)).await??)
}

#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct Arm {
    cycle: u16,
    who: String,
    /// An instant, or a duration from now: `14d`.
    until: String,
    #[serde(default)]
    why: String,
}

/// Arm a cycle: it may start unattended at its scheduled times, until the given instant.
#[utoipa::path(post, path = "/api/v1/machines/{name}/arm", params(("name" = String, Path)), request_body = Arm, responses((status = ACCEPTED, body = AgendaView)))]
async fn arm(
    State(web): State<AppState>,
    Path(name): Path<String>,
    Extension(caller): Extension<Caller>,
    words: JsonOrForm<Arm>,
) -> Result<Response, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let (Arm { cycle, who, until, why }, to_page) = words.split();
    let who = caller.signs(&who)?;
    if !machine.cycles.iter().any(|known| known.number == cycle) {
        return Err(Refusal::NoSuchCycle.into());
    }
    let now = Timestamp::now();
    let arming =
        arming((&name, cycle), (&who, &truncate_reason(&why)), &until, now).map_err(|why| {
            let remedy = "say until when, such as 14d or 2027-01-31T18:00:00+01:00";
            Problem::new(StatusCode::BAD_REQUEST, "until", why, remedy)
        })?;
    web.journal.arm(&arming).await?;
    answer(&web, machine, to_page).await
}

#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct Disarm {
    /// Cycle to disarm; all cycles if absent.
    cycle: Option<u16>,
    who: String,
    #[serde(default)]
    why: String,
}

/// Disarm cycles: they no longer start unattended.
#[utoipa::path(post, path = "/api/v1/machines/{name}/disarm", params(("name" = String, Path)), request_body = Disarm, responses((status = ACCEPTED, body = AgendaView)))]
async fn disarm(
    State(web): State<AppState>,
    Path(name): Path<String>,
    Extension(caller): Extension<Caller>,
    words: JsonOrForm<Disarm>,
) -> Result<Response, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let (Disarm { cycle, who, why }, to_page) = words.split();
    web.journal.disarm(&name, cycle, &caller.signs(&who)?, &truncate_reason(&why)).await?;
    answer(&web, machine, to_page).await
}

#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct Due {
    cycle: u16,
    who: String,
    #[serde(default)]
    why: String,
}

/// Report that a cycle is due now. It starts once, under the conditions of the schedule: armed and ready.
#[utoipa::path(post, path = "/api/v1/machines/{name}/due", params(("name" = String, Path)), request_body = Due, responses((status = ACCEPTED, body = AgendaView)))]
async fn due(
    State(web): State<AppState>,
    Path(name): Path<String>,
    Extension(caller): Extension<Caller>,
    words: JsonOrForm<Due>,
) -> Result<Response, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let (due, to_page) = words.split();
    let due = Due { who: caller.signs(&due.who)?, ..due };
    to_the_end(called(web.clone(), machine.clone(), due)).await?;
    answer(&web, machine, to_page).await
}

async fn called(web: AppState, machine: ServedMachine, due: Due) -> Result<(), Problem> {
    let Due { cycle, who, why } = due;
    let answered = match machine.gate.request_due(cycle, who.clone()) {
        Some(told) => told.await.unwrap_or_else(|_| Err(Refusal::NotReady.to_string())),
        None => Err(Refusal::NotReady.to_string()),
    };
    let outcome = match &answered {
        Ok(()) => "accepted".to_owned(),
        Err(why) => format!("refused: {why}"),
    };
    let (what, run) = (format!("cycle {cycle} is due"), machine.gate.machine_state().run.into());
    let audit =
        Audit { who, what, why: truncate_reason(&why), machine: machine.name, run, outcome };
    web.journal.audit(&audit).await?;
    answered.map_err(|why| {
        let remedy = "it stands in the schedule as skipped; see to it, then ask again";
        Problem::new(StatusCode::CONFLICT, "not-started", why, remedy)
    })
}

async fn answer(
    web: &AppState,
    machine: &ServedMachine,
    to_page: bool,
) -> Result<Response, Problem> {
    Ok(match to_page {
        true => Redirect::to(&super::page::address(&machine.name)).into_response(),
        false => (StatusCode::ACCEPTED, Json(of(web, machine).await?)).into_response(),
    })
}
