//! What can be done: start a cycle, hold the machine, acknowledge. Each says who asks, and each stands in
//! the audit log before it is answered. The same words come as JSON from a program and as a form from the
//! page, which is sent back to the machine's page.

use axum::extract::rejection::{FormRejection, JsonRejection};
use axum::extract::{FromRequest, Path, Request, State};
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Redirect, Response};
use axum::routing::post;
use axum::{Form, Json, Router};
use serde::Deserialize;
use serde::de::DeserializeOwned;

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

/// JSON or a form, by what the request says it is.
pub(super) enum Words<T> {
    Json(T),
    Form(T),
}

impl<T> Words<T> {
    /// What was said, and whether the answer is for a person at the page.
    pub(super) fn split(self) -> (T, bool) {
        match self {
            Self::Json(said) => (said, false),
            Self::Form(said) => (said, true),
        }
    }
}

impl<T: DeserializeOwned + 'static, S: Send + Sync> FromRequest<S> for Words<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &S) -> Result<Self, Problem> {
        let kind = request.headers().get(CONTENT_TYPE).and_then(|kind| kind.to_str().ok());
        match kind.is_some_and(|kind| kind.starts_with("application/json")) {
            true => Ok(Self::Json(Json::from_request(request, state).await.map_err(not_json)?.0)),
            false => Ok(Self::Form(Form::from_request(request, state).await.map_err(no_form)?.0)),
        }
    }
}

fn not_json(error: JsonRejection) -> Problem {
    Problem::new(error.status(), "unreadable", error.body_text(), "send what the API describes")
}

fn no_form(error: FormRejection) -> Problem {
    Problem::new(error.status(), "unreadable", error.body_text(), "send what the page's form sends")
}

/// Who asks must have a name.
pub(super) fn named(who: &str) -> Result<String, Problem> {
    let who = who.trim();
    match who.is_empty() || who.chars().count() > 100 || who.chars().any(char::is_control) {
        true => Err(Problem::new(
            StatusCode::BAD_REQUEST,
            "nameless",
            "nobody has given a name",
            "say who you are: it stands in the log of this machine",
        )),
        false => Ok(who.to_owned()),
    }
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
    missing.map_or(Ok(()), |what| {
        Err(Problem::new(
            StatusCode::CONFLICT,
            "not-vouched",
            format!("nobody has vouched {what}"),
            "look at the machine, then say so",
        ))
    })
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
