//! Answer of a person to the run's prompt.

use axum::extract::{Extension, Path, State};
use axum::response::Response;
use serde::Deserialize;
use utoipa::ToSchema;

use super::answer;
use super::words::JsonOrForm;
use crate::service::http::AppState;
use crate::service::http::access::Caller;
use crate::service::http::problem::Problem;
use crate::service::http::status::MachineStatus;

#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Done {
    /// Step of the prompt; `repeat` is its pass.
    step: u32,
    #[serde(default)]
    repeat: u32,
    who: String,
}

/// Answer the run's prompt: the requested action is done, and the run continues.
/// An answer to any other prompt is refused.
#[utoipa::path(post, path = "/api/v1/machines/{name}/answer", params(("name" = String, Path)), request_body = Done, responses((status = ACCEPTED, body = MachineStatus)))]
pub async fn done(
    State(web): State<AppState>,
    Path(name): Path<String>,
    Extension(caller): Extension<Caller>,
    words: JsonOrForm<Done>,
) -> Result<Response, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let (Done { step, repeat, who }, to_page) = words.split();
    let who = caller.signs(&who)?;
    let accepted = machine.gate.answer((step, repeat), &who);
    let what = format!("answer to step {step}, pass {}", repeat + 1);
    answer(&web, machine, (who, what, String::new()), accepted, to_page).await
}
