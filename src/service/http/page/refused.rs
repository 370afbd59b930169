//! What a person is told whose request came to nothing: the words of the answer as a page.

use axum::body::to_bytes;
use axum::http::HeaderMap;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use minijinja::context;
use serde::Deserialize;

use super::whole;

/// No answer of this kind is longer, bytes.
const MOST: usize = 64 * 1024;

#[derive(Deserialize)]
struct Words {
    message: String,
    remedy: String,
}

/// If it says why there is no answer. `tokens`: as for [`whole`].
pub async fn as_page(response: Response, tokens: bool) -> Response {
    let told = is_json(response.headers());
    if !told || response.status().is_success() {
        return response;
    }
    let (mut parts, body) = response.into_parts();
    let bytes = to_bytes(body, MOST).await.unwrap_or_default();
    let page = serde_json::from_slice(&bytes).ok().and_then(|Words { message, remedy }| {
        whole("refused.html", tokens, context! { message, remedy }).ok()
    });
    match page {
        Some(page) => {
            // What else its head says, such as when to ask again, it says still.
            parts.headers.remove(CONTENT_TYPE);
            (parts.status, parts.headers, page).into_response()
        }
        None => (parts, bytes).into_response(),
    }
}

/// By the head of a request or of an answer.
pub fn is_json(headers: &HeaderMap) -> bool {
    let kind = headers.get(CONTENT_TYPE).and_then(|kind| kind.to_str().ok());
    kind.is_some_and(|kind| kind.starts_with("application/json"))
}
