//! What is due when, and what became of it; who lets it start while nobody is there.

use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Redirect, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use jiff::Timestamp;
use serde::Deserialize;

use super::actions::{Words, named};
use super::api::look;
use super::problem::Problem;
use super::{Shown, Web};
use crate::service::board::Refusal;
use crate::service::rota::{Agenda, agenda, arming};
use crate::store::Audit;

pub fn routes() -> Router<Web> {
    Router::new()
        .route("/api/v1/machines/{name}/schedule", get(schedule))
        .route("/api/v1/machines/{name}/arm", post(arm))
        .route("/api/v1/machines/{name}/disarm", post(disarm))
        .route("/api/v1/machines/{name}/due", post(due))
}

async fn schedule(
    State(web): State<Web>,
    Path(name): Path<String>,
) -> Result<Json<Agenda>, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    Ok(Json(of(&web, machine).await?))
}

async fn of(web: &Web, machine: &Shown) -> Result<Agenda, Problem> {
    let (desk, name) = (machine.desk.clone(), machine.name.clone());
    Ok(look(web, move |journal| agenda(journal, &desk, &name)).await??)
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Arm {
    cycle: u16,
    who: String,
    /// An instant, or how long from now: `14d`.
    until: String,
    #[serde(default)]
    why: String,
}

async fn arm(
    State(web): State<Web>,
    Path(name): Path<String>,
    words: Words<Arm>,
) -> Result<Response, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let (Arm { cycle, who, until, why }, to_page) = words.split();
    let who = named(&who)?;
    if !machine.cycles.iter().any(|known| known.number == cycle) {
        return Err(Refusal::NoSuchCycle.into());
    }
    let now = Timestamp::now();
    let arming = arming((&name, cycle), (&who, &why), &until, now).map_err(|why| {
        let remedy = "say until when, such as 14d or 2027-01-31T18:00:00+01:00";
        Problem::new(StatusCode::BAD_REQUEST, "until", why, remedy)
    })?;
    web.journal.arm(&arming).await?;
    answer(&web, machine, to_page).await
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Disarm {
    /// All of them, if none is named.
    cycle: Option<u16>,
    who: String,
    #[serde(default)]
    why: String,
}

async fn disarm(
    State(web): State<Web>,
    Path(name): Path<String>,
    words: Words<Disarm>,
) -> Result<Response, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let (Disarm { cycle, who, why }, to_page) = words.split();
    web.journal.disarm(&name, cycle, &named(&who)?, &why).await?;
    answer(&web, machine, to_page).await
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Due {
    cycle: u16,
    who: String,
}

/// As if its time had come by the schedule: armed, ready, and once.
async fn due(
    State(web): State<Web>,
    Path(name): Path<String>,
    words: Words<Due>,
) -> Result<Response, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let (Due { cycle, who }, to_page) = words.split();
    let who = named(&who)?;
    let answered = match machine.desk.rota().due(cycle, who.clone()) {
        Some(told) => told.await.unwrap_or_else(|_| Err(Refusal::NotReady.to_string())),
        None => Err(Refusal::NotReady.to_string()),
    };
    let outcome = match &answered {
        Ok(()) => "accepted".to_owned(),
        Err(why) => format!("refused: {why}"),
    };
    let (what, run) = (format!("cycle {cycle} is due"), machine.desk.board().run.into());
    let audit = Audit { who, what, why: String::new(), machine: name, run, outcome };
    web.journal.audit(&audit).await?;
    answered.map_err(|why| {
        let remedy = "it stands in the schedule as skipped; see to it, then ask again";
        Problem::new(StatusCode::CONFLICT, "not-started", why, remedy)
    })?;
    answer(&web, machine, to_page).await
}

async fn answer(web: &Web, machine: &Shown, to_page: bool) -> Result<Response, Problem> {
    Ok(match to_page {
        true => Redirect::to(&super::page::address(&machine.name)).into_response(),
        false => (StatusCode::ACCEPTED, Json(of(web, machine).await?)).into_response(),
    })
}
