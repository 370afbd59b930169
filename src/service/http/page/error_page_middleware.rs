//! Shows a failed request of a browser as a page.

use axum::extract::Request;
use axum::middleware::Next;
use axum::response::Response;

use super::error_page::{error_page, has_form_content_type, has_json_content_type};
use crate::service::http::access::Caller;

/// Middleware: an error response becomes a page, unless a program sent the request.
pub async fn errors_as_pages(request: Request, next: Next) -> Response {
    let is_form = has_form_content_type(request.headers());
    let is_from_program = has_json_content_type(request.headers()) || !(request.method().is_safe() || is_form);
    let has_sign_in_link = request.extensions().get::<Caller>().is_some_and(Caller::has_token);
    let response = next.run(request).await;
    match is_from_program {
        true => response,
        false => error_page(response, has_sign_in_link).await,
    }
}
