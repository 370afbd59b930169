//! A person has done what the run asked for.

use axum::extract::{Extension, Path, State};
use axum::response::Response;
use serde::Deserialize;
use utoipa::ToSchema;

use super::answer;
use super::words::Words;
use crate::service::http::Web;
use crate::service::http::access::Caller;
use crate::service::http::problem::Problem;
use crate::service::http::standing::Standing;

#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Done {
    /// The step that asked, and its pass.
    step: u32,
    #[serde(default)]
    repeat: u32,
    who: String,
}

/// What the run that is on has asked for is done: it goes on. An answer to anything else is refused.
#[utoipa::path(post, path = "/api/v1/machines/{name}/answer", params(("name" = String, Path)), request_body = Done, responses((status = ACCEPTED, body = Standing)))]
pub async fn done(
    State(web): State<Web>,
    Path(name): Path<String>,
    Extension(caller): Extension<Caller>,
    words: Words<Done>,
) -> Result<Response, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let (Done { step, repeat, who }, to_page) = words.split();
    let who = caller.signs(&who)?;
    let accepted = machine.desk.answer((step, repeat), &who);
    let what = format!("answer to step {step}, pass {}", repeat + 1);
    answer(&web, machine, (who, what, String::new()), accepted, to_page).await
}
