//! What can be done: start a cycle, hold the machine, acknowledge, resume, answer, sign. Each says who asks and may
//! say why, and each stands in the audit log before it is answered, also if whoever asked has gone by then. The same
//! words come as JSON from a program and as a form from the page, which is sent back to the machine's page.

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
pub(super) use self::words::{Words, kept};
use super::access::Caller;
use super::page::for_people;
use super::problem::Problem;
use super::standing::Standing;
use super::{Shown, Web};
use crate::service::ask::{Answer, Looked, Stopped};
use crate::service::board::{Refusal, Said};
use crate::service::config::Demand;
use crate::store::Audit;

/// For the words of a hold, which come after it.
const PATIENCE: Duration = Duration::from_secs(2);
/// An acknowledgement is in the journal, or refused.
const SETTLES: Duration = Duration::from_secs(5);

pub fn routes() -> OpenApiRouter<Web> {
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
    /// What this person has seen to at the machine.
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
    /// All axes, where the control may have lost its position.
    #[serde(default)]
    homed: bool,
}

/// Start a cycle. Its caller vouches for what `[serve]` demands.
#[utoipa::path(post, path = "/api/v1/machines/{name}/start", params(("name" = String, Path)), request_body = Start, responses((status = ACCEPTED, body = Standing)))]
async fn start(
    State(web): State<Web>,
    Path(name): Path<String>,
    Extension(caller): Extension<Caller>,
    words: Words<Start>,
) -> Result<Response, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let (asked, to_page) = words.split();
    let who = caller.signs(&asked.who)?;
    vouched(machine, &asked)?;
    let accepted = machine.desk.start(asked.cycle, said(machine), &who);
    let what = format!("start of cycle {}", asked.cycle);
    answer(&web, machine, (who, what, asked.why), accepted, to_page).await
}

/// A person has vouched; what the machine says against it counts all the same.
fn said(machine: &Shown) -> Said {
    let vouched =
        Said { fresh: true, enable: true, auto: true, door: true, stop: false, person: true };
    machine.desk.rota().heard().map_or(vouched, |said| Said { person: true, ..said })
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

/// Hold the machine at once. This is never refused to whoever is known; what is said beside it may be missing.
#[utoipa::path(post, path = "/api/v1/machines/{name}/hold", params(("name" = String, Path)), request_body = Asked, responses((status = ACCEPTED, body = Standing)))]
async fn hold(
    State(web): State<Web>,
    Path(name): Path<String>,
    Extension(caller): Extension<Caller>,
    request: Request,
) -> Result<Response, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    // Before anything is read: whatever else is wrong with the request, the machine holds.
    let stopped = machine.desk.stop(&caller.is_called(""));
    to_the_end(held(web.clone(), machine.clone(), caller, stopped, request)).await
}

async fn held(
    web: Web,
    machine: Shown,
    caller: Caller,
    stopped: Stopped,
    request: Request,
) -> Result<Response, Problem> {
    let words = tokio::time::timeout(PATIENCE, Words::<Asked>::from_request(request, &()));
    let words = words.await.ok().and_then(Result::ok).unwrap_or(Words::Json(Asked::default()));
    let (Asked { who, why }, to_page) = words.split();
    let held = match stopped {
        // It is not for this service to hold what another one moves.
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

/// Also if whoever asked has gone meanwhile: what is done is written down.
pub(super) async fn to_the_end<T: Send + 'static>(
    work: impl Future<Output = Result<T, Problem>> + Send + 'static,
) -> Result<T, Problem> {
    tokio::spawn(work).await.unwrap_or_else(|_| Err(Refusal::NotReady.into()))
}

/// A person has looked at the machine: new cycles may start.
#[utoipa::path(post, path = "/api/v1/machines/{name}/acknowledge", params(("name" = String, Path)), request_body = Seen, responses((status = ACCEPTED, body = Standing)))]
async fn acknowledge(
    State(web): State<Web>,
    Path(name): Path<String>,
    Extension(caller): Extension<Caller>,
    words: Words<Seen>,
) -> Result<Response, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?.clone();
    let (Seen { who, why, homed }, to_page) = words.split();
    let (who, why) = (caller.signs(&who)?, kept(&why));
    let accepted = machine.desk.acknowledge(Looked { who: &who, why: &why, homed });
    let said = (who, "acknowledgement".to_owned(), why);
    settled(web, machine, said, accepted, to_page).await
}

/// What became of it stands in the audit log, even if nobody waits for the answer.
async fn settled(
    web: Web,
    machine: Shown,
    said: (String, String, String),
    accepted: Result<Answer, Refusal>,
    to_page: bool,
) -> Result<Response, Problem> {
    to_the_end(async move {
        let became = match accepted {
            // One that is still at it says so on the board.
            Ok(told) => tokio::time::timeout(SETTLES, told)
                .await
                // Nobody took it any more: the service ends.
                .map_or(Ok(()), |told| told.unwrap_or(Err(Refusal::NotReady))),
            Err(why) => Err(why),
        };
        answer(&web, &machine, said, became, to_page).await
    })
    .await
}

/// Once it stands in the audit log.
async fn answer(
    web: &Web,
    machine: &Shown,
    (who, what, why): (String, String, String),
    accepted: Result<(), Refusal>,
    to_page: bool,
) -> Result<Response, Problem> {
    web.journal.audit(&audit(machine, (who, what, why), &accepted)).await?;
    accepted?;
    Ok(answered(machine, to_page))
}

fn audit(
    machine: &Shown,
    (who, what, why): (String, String, String),
    accepted: &Result<(), Refusal>,
) -> Audit {
    let outcome = match accepted {
        Ok(()) => "accepted".to_owned(),
        Err(refusal) => format!("refused: {refusal}"),
    };
    let (name, run) = (machine.name.clone(), machine.desk.board().run);
    Audit { who, what, why: kept(&why), machine: name, run: run.into(), outcome }
}

fn answered(machine: &Shown, to_page: bool) -> Response {
    match to_page {
        true => Redirect::to(&super::page::address(&machine.name)).into_response(),
        false => (StatusCode::ACCEPTED, Json(Standing::of(machine))).into_response(),
    }
}
