//! Shows a failed request of a browser as a page.

use axum::extract::Request;
use axum::middleware::Next;
use axum::response::Response;

use super::error_page::{error_page, is_json};
use crate::service::http::access::Caller;

/// Middleware: an error response becomes a page, unless a program sent the request.
pub async fn errors_as_pages(request: Request, next: Next) -> Response {
    let program = is_json(request.headers());
    let tokens = request.extensions().get::<Caller>().is_some_and(Caller::has_token);
    let response = next.run(request).await;
    match program {
        true => response,
        false => error_page(response, tokens).await,
    }
}
