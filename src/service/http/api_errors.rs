//! Errors of the HTTP API that arise before a handler: no such address, another method, an invalid path, query or
//! body. The HTTP library answers these with plain text or without a body; here they become a [`Problem`] too.

use axum::body::to_bytes;
use axum::extract::Request;
use axum::http::header::{CONTENT_LENGTH, CONTENT_TYPE};
use axum::http::{HeaderMap, Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::page::has_json_content_type;
use super::problem::Problem;
use super::request_checks::MAX_REQUEST_BODY_BYTES;

/// Path of the API; pages have other paths.
const API_ROOT: &str = "/api";
/// Maximum size of an error message of the HTTP library, bytes; a longer message is replaced by the name of the status.
const MAX_ERROR_MESSAGE_BYTES: usize = 16 * 1024;

/// Middleware: every error response of the API has the body of a [`Problem`], except one that is already a page for
/// a browser. `OPTIONS` returns the methods of an address.
pub async fn unify_api_errors(request: Request, next: Next) -> Response {
    let (method, path) = (request.method().clone(), request.uri().path().to_owned());
    let is_api = path.strip_prefix(API_ROOT).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'));
    let response = next.run(request).await;
    if !is_api || !(response.status().is_client_error() || response.status().is_server_error()) {
        return response;
    }
    if response.status() == StatusCode::METHOD_NOT_ALLOWED && method == Method::OPTIONS {
        // RFC 9110, 9.3.7. The router adds the header `Allow` after this.
        return StatusCode::NO_CONTENT.into_response();
    }
    if has_json_content_type(response.headers()) || is_page(response.headers()) {
        return response;
    }
    let (mut parts, body) = response.into_parts();
    let message = to_bytes(body, MAX_ERROR_MESSAGE_BYTES).await.unwrap_or_default();
    let problem = unhandled_problem(parts.status, &method, &path, &String::from_utf8_lossy(&message));
    parts.headers.remove(CONTENT_TYPE);
    parts.headers.remove(CONTENT_LENGTH);
    (parts.status, parts.headers, problem).into_response()
}

fn is_page(headers: &HeaderMap) -> bool {
    headers.get(CONTENT_TYPE).is_some_and(|kind| kind.as_bytes().starts_with(b"text/html"))
}

/// `message`: text of the HTTP library; may be empty.
fn unhandled_problem(status: StatusCode, method: &Method, path: &str, message: &str) -> Problem {
    let reason = status.canonical_reason().unwrap_or("error");
    let message = if message.is_empty() { reason.to_owned() } else { message.to_owned() };
    let remedy = "correct the request: /api/v1/openapi.json describes it";
    match status {
        StatusCode::NOT_FOUND => Problem::new(
            status,
            "not-found",
            format!("the interface has no address {path}"),
            "use an address of /api/v1/openapi.json",
        ),
        StatusCode::METHOD_NOT_ALLOWED => Problem::new(
            status,
            "method-not-allowed",
            format!("{method} is not a method of {path}"),
            "use a method that the header `Allow` lists",
        ),
        StatusCode::PAYLOAD_TOO_LARGE => {
            let remedy = format!("send a body of at most {MAX_REQUEST_BODY_BYTES} bytes");
            Problem::new(status, "unreadable", message, remedy)
        }
        _ if status.is_client_error() => Problem::new(status, "unreadable", message, remedy),
        _ => Problem::new(
            status,
            "failed",
            message,
            "repeat the request; if it fails again, read the log of the service",
        ),
    }
}
