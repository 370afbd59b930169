//! What can be done: start a cycle, hold the machine, acknowledge, resume, sign. Each says who asks, and each
//! stands in the audit log before it is answered. The same words come as JSON from a program and as a form from the
//! page, which is sent back to the machine's page.

mod resume;
mod sign;
mod words;

use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::middleware::from_fn;
use axum::response::{IntoResponse, Redirect, Response};
use axum::routing::post;
use axum::{Json, Router};
use serde::Deserialize;

pub(super) use self::words::{Words, named};
use super::page::for_people;
use super::problem::Problem;
use super::standing::Standing;
use super::{Shown, Web};
use crate::service::board::{Refusal, Said};
use crate::service::config::Demand;
use crate::store::Audit;

pub fn routes() -> Router<Web> {
    Router::new()
        .route("/api/v1/machines/{name}/start", post(start))
        .route("/api/v1/machines/{name}/hold", post(hold))
        .route("/api/v1/machines/{name}/acknowledge", post(acknowledge))
        .route("/api/v1/machines/{name}/resume", post(resume::resume))
        .route("/api/v1/runs/{run}/sign", post(sign::sign))
        .layer(from_fn(for_people))
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Start {
    cycle: u16,
    who: String,
    /// What this person has seen to at the machine.
    #[serde(default)]
    enable: bool,
    #[serde(default)]
    auto: bool,
    #[serde(default)]
    door: bool,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Asked {
    #[serde(default)]
    who: String,
    #[serde(default)]
    why: String,
}

async fn start(
    State(web): State<Web>,
    Path(name): Path<String>,
    words: Words<Start>,
) -> Result<Response, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let (asked, to_page) = words.split();
    let who = named(&asked.who)?;
    vouched(machine, &asked)?;
    // A person at the page has vouched for the rest.
    let said = Said { fresh: true, enable: true, auto: true, door: true, stop: false };
    let accepted = machine.desk.start(asked.cycle, said, &who);
    let what = format!("start of cycle {}", asked.cycle);
    answer(&web, machine, (who, what, String::new()), accepted, to_page).await
}

fn vouched(machine: &Shown, asked: &Start) -> Result<(), Problem> {
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

async fn hold(
    State(web): State<Web>,
    Path(name): Path<String>,
    words: Words<Asked>,
) -> Result<Response, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let (Asked { who, why }, to_page) = words.split();
    // Whoever asks: a hold is never refused for want of a name.
    let who = if who.trim().is_empty() { "somebody at the page".to_owned() } else { who };
    machine.desk.stop(&who);
    answer(&web, machine, (who, "hold".to_owned(), why), Ok(()), to_page).await
}

async fn acknowledge(
    State(web): State<Web>,
    Path(name): Path<String>,
    words: Words<Asked>,
) -> Result<Response, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let (Asked { who, why }, to_page) = words.split();
    let who = named(&who)?;
    let accepted = machine.desk.acknowledge(&who);
    answer(&web, machine, (who, "acknowledgement".to_owned(), why), accepted, to_page).await
}

/// Once it stands in the audit log.
async fn answer(
    web: &Web,
    machine: &Shown,
    (who, what, why): (String, String, String),
    accepted: Result<(), Refusal>,
    to_page: bool,
) -> Result<Response, Problem> {
    let outcome = match accepted {
        Ok(()) => "accepted".to_owned(),
        Err(refusal) => format!("refused: {refusal}"),
    };
    let (machine_name, run) = (machine.name.clone(), machine.desk.board().run);
    let audit = Audit { who, what, why, machine: machine_name, run: run.into(), outcome };
    web.journal.audit(&audit).await?;
    accepted?;
    Ok(match to_page {
        true => Redirect::to(&super::page::address(&machine.name)).into_response(),
        false => (StatusCode::ACCEPTED, Json(Standing::of(machine))).into_response(),
    })
}
