//! A person's request to act on a machine, with its body as JSON or as a form.

use axum::extract::rejection::{FormRejection, JsonRejection};
use axum::extract::{Extension, FromRequest, Path, Request};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use axum::{Form, Json, RequestExt};
use serde::de::DeserializeOwned;

use crate::service::http::access::Caller;
use crate::service::http::page::has_json_content_type;
use crate::service::http::problem::Problem;
use crate::service::http::{AppState, ServedMachine};

/// Maximum length of a reason, in characters.
const MAX_REASON_CHARS: usize = 500;

/// Reason as it is stored: trimmed and shortened, because the audit log is permanent.
pub fn truncate_reason(why: &str) -> String {
    why.trim().chars().take(MAX_REASON_CHARS).collect()
}

/// Body of a request: JSON or a form, according to its content type.
#[derive(Default)]
pub struct JsonOrFormBody<T> {
    pub body: T,
    /// Whether the body is not JSON: the page's form sent the request, so that the response is a page.
    pub is_form: bool,
}

impl<T: DeserializeOwned + 'static, S: Send + Sync> FromRequest<S> for JsonOrFormBody<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &S) -> Result<Self, Problem> {
        let is_form = !has_json_content_type(request.headers());
        let body = match is_form {
            true => Form::from_request(request, state).await.map_err(form_problem)?.0,
            false => Json::from_request(request, state).await.map_err(json_problem)?.0,
        };
        Ok(Self { body, is_form })
    }
}

/// A request to act on a machine.
pub struct ActionRequest<T> {
    pub app: AppState,
    pub machine: ServedMachine,
    pub caller: Caller,
    pub body: T,
    /// As in [`JsonOrFormBody`].
    pub is_form: bool,
}

impl<T: DeserializeOwned + 'static> FromRequest<AppState> for ActionRequest<T> {
    type Rejection = Response;

    async fn from_request(mut request: Request, app: &AppState) -> Result<Self, Response> {
        let Path(name) = request.extract_parts::<Path<String>>().await.map_err(IntoResponse::into_response)?;
        let Extension(caller) = request.extract_parts().await.map_err(IntoResponse::into_response)?;
        let body = JsonOrFormBody::from_request(request, app).await.map_err(IntoResponse::into_response)?;
        let JsonOrFormBody { body, is_form } = body;
        let machine = app.find_machine(&name).map_err(IntoResponse::into_response)?.clone();
        Ok(Self { app: app.clone(), machine, caller, body, is_form })
    }
}

fn json_problem(error: JsonRejection) -> Problem {
    Problem::new(error.status(), "unreadable", error.body_text(), "send JSON as described in /api/v1/openapi.json")
}

fn form_problem(error: FormRejection) -> Problem {
    let remedy = match error.status() {
        StatusCode::UNSUPPORTED_MEDIA_TYPE => "send JSON with the header `Content-Type: application/json`",
        _ => "send the fields of the page's form",
    };
    Problem::new(error.status(), "unreadable", error.body_text(), remedy)
}
