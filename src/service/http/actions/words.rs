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
    pub fn split(self) -> (T, bool) {
        match self {
            Self::Json(said) => (said, false),
            Self::Form(said) => (said, true),
        }
    }
}

impl<T: DeserializeOwned + 'static, S: Send + Sync> FromRequest<S> for JsonOrForm<T> {
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
