//! Body of a request, as JSON or as a form.

use axum::extract::rejection::{FormRejection, JsonRejection};
use axum::extract::{FromRequest, Request};
use axum::http::header::CONTENT_TYPE;
use axum::{Form, Json};
use serde::de::DeserializeOwned;

use crate::service::http::problem::Problem;

/// Maximum length of a reason, in characters.
const MAX_REASON_CHARS: usize = 500;

/// Reason as it is stored: trimmed and shortened, because the audit log is permanent.
pub fn truncate_reason(why: &str) -> String {
    why.trim().chars().take(MAX_REASON_CHARS).collect()
}

/// Body of a request: JSON or a form, according to its content type.
pub enum JsonOrForm<T> {
    Json(T),
    Form(T),
}

impl<T> JsonOrForm<T> {
    /// The body, and whether it came from the page's form, so that the response is a page.
    pub fn into_parts(self) -> (T, bool) {
        match self {
            Self::Json(body) => (body, false),
            Self::Form(body) => (body, true),
        }
    }
}

impl<T: DeserializeOwned + 'static, S: Send + Sync> FromRequest<S> for JsonOrForm<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &S) -> Result<Self, Problem> {
        let content_type = request.headers().get(CONTENT_TYPE).and_then(|content_type| content_type.to_str().ok());
        match content_type.is_some_and(|content_type| content_type.starts_with("application/json")) {
            true => Ok(Self::Json(Json::from_request(request, state).await.map_err(json_problem)?.0)),
            false => Ok(Self::Form(Form::from_request(request, state).await.map_err(form_problem)?.0)),
        }
    }
}

fn json_problem(error: JsonRejection) -> Problem {
    Problem::new(error.status(), "unreadable", error.body_text(), "send JSON as described in /api/v1/openapi.json")
}

fn form_problem(error: FormRejection) -> Problem {
    Problem::new(error.status(), "unreadable", error.body_text(), "send the fields of the page's form")
}
