//! Answer of a person to the run's prompt.

use axum::extract::{Extension, Path, State};
use axum::response::Response;
use serde::Deserialize;
use utoipa::ToSchema;

use super::audit_and_respond;
use super::body::JsonOrForm;
use crate::service::http::AppState;
use crate::service::http::access::Caller;
use crate::service::http::problem::Problem;
use crate::service::http::status::MachineStatus;

#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct AnswerRequest {
    /// Step of the prompt; `repeat` is its pass.
    step: u32,
    #[serde(default)]
    repeat: u32,
    who: String,
}

/// Answer the run's prompt: the requested action is done, and the run continues.
/// An answer to any other prompt is refused.
#[utoipa::path(post, path = "/api/v1/machines/{name}/answer", operation_id = "done", params(("name" = String, Path)), request_body = AnswerRequest, responses((status = ACCEPTED, body = MachineStatus)))]
pub async fn answer_prompt(
    State(app): State<AppState>,
    Path(name): Path<String>,
    Extension(caller): Extension<Caller>,
    body: JsonOrForm<AnswerRequest>,
) -> Result<Response, Problem> {
    let machine = app.find_machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let (AnswerRequest { step, repeat, who }, is_form) = body.into_parts();
    let who = caller.audit_name(&who)?;
    let accepted = machine.gate.answer(step, repeat, &who);
    let what = format!("answer to step {step}, pass {}", repeat + 1);
    audit_and_respond(&app, machine, who, what, String::new(), accepted, is_form).await
}
