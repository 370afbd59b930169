//! Page for a request that failed: shows the error response as HTML.

use axum::body::to_bytes;
use axum::http::HeaderMap;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use minijinja::context;
use serde::Deserialize;

use super::render_page;

/// Maximum size of an error response, bytes.
const MAX_ERROR_BYTES: usize = 64 * 1024;

#[derive(Deserialize)]
struct ErrorText {
    message: String,
    remedy: String,
}

/// Converts an error response to a page; leaves others as they are. `tokens`: as for [`render_page`].
pub async fn error_page(response: Response, tokens: bool) -> Response {
    if !is_json(response.headers()) || response.status().is_success() {
        return response;
    }
    let (mut parts, body) = response.into_parts();
    let bytes = to_bytes(body, MAX_ERROR_BYTES).await.unwrap_or_default();
    let page = serde_json::from_slice(&bytes).ok().and_then(|ErrorText { message, remedy }| {
        render_page("refused.html", tokens, context! { message, remedy }).ok()
    });
    match page {
        Some(page) => {
            // The other headers stay, for example `Retry-After`.
            parts.headers.remove(CONTENT_TYPE);
            (parts.status, parts.headers, page).into_response()
        }
        None => (parts, bytes).into_response(),
    }
}

/// Whether the content type of a request or a response is JSON.
pub fn is_json(headers: &HeaderMap) -> bool {
    let kind = headers.get(CONTENT_TYPE).and_then(|kind| kind.to_str().ok());
    kind.is_some_and(|kind| kind.starts_with("application/json"))
}
