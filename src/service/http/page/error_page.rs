//! Page for a request that failed: shows the error response as HTML.

use axum::body::to_bytes;
use axum::http::HeaderMap;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use minijinja::context;
use serde::Deserialize;

use super::render_page;

/// Maximum size of an error response, bytes.
const MAX_ERROR_RESPONSE_BYTES: usize = 64 * 1024;

/// The parts of an error response that the page shows.
#[derive(Deserialize)]
struct ErrorText {
    message: String,
    remedy: String,
}

/// Converts an error response in JSON to a page; leaves all other responses as they are. `has_sign_in_link`: as for
/// [`render_page`].
pub async fn error_page(response: Response, has_sign_in_link: bool) -> Response {
    if !has_json_content_type(response.headers()) || response.status().is_success() {
        return response;
    }
    let (mut parts, body) = response.into_parts();
    let bytes = to_bytes(body, MAX_ERROR_RESPONSE_BYTES).await.unwrap_or_default();
    let page = serde_json::from_slice(&bytes).ok().and_then(|ErrorText { message, remedy }| {
        render_page("refused.html", has_sign_in_link, context! { message, remedy }).ok()
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
pub fn has_json_content_type(headers: &HeaderMap) -> bool {
    has_content_type(headers, "application/json")
}

/// Whether a request is a form of a page.
pub fn has_form_content_type(headers: &HeaderMap) -> bool {
    has_content_type(headers, "application/x-www-form-urlencoded")
}

fn has_content_type(headers: &HeaderMap, start: &str) -> bool {
    headers.get(CONTENT_TYPE).is_some_and(|kind| kind.as_bytes().starts_with(start.as_bytes()))
}
