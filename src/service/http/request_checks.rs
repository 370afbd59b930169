//! Checks before every response. Requests must be small, complete in time and addressed to this server. Requests
//! that change something must come from this server's own page or from a program, never from another site's page.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::{DefaultBodyLimit, Request, State};
use axum::http::StatusCode;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE, HOST, HeaderName, HeaderValue, ORIGIN};
use axum::middleware::{Next, from_fn, from_fn_with_state};
use axum::response::{IntoResponse, Response};

use super::access::{AccessControl, check_access};
use super::problem::Problem;

/// Maximum size of a request body, bytes.
pub(super) const MAX_REQUEST_BODY_BYTES: usize = 16 * 1024;
/// Maximum time to receive and process a request that changes something.
const CHANGING_REQUEST_TIMEOUT: Duration = Duration::from_secs(10);
/// The report contains inline styles. No page contains inline scripts, and nothing is loaded from other origins.
const CONTENT_SECURITY_POLICY: &str = "default-src 'none'; script-src 'self'; connect-src 'self'; img-src 'self'; \
                      style-src 'self' 'unsafe-inline'; form-action 'self'; frame-ancestors 'none'; \
                      base-uri 'none'";

/// Host names of this server as a client may write them in the header Host, with the port where it is needed; lower
/// case.
#[derive(Debug, Clone)]
pub struct OwnHostNames(Arc<[String]>);

impl OwnHostNames {
    /// `listen`: address on which the server listens. `proxy_names`: host names of the proxy in front of the server.
    pub fn new(listen: SocketAddr, proxy_names: &[String]) -> Self {
        let port = listen.port();
        let own = [listen.to_string(), format!("localhost:{port}"), format!("127.0.0.1:{port}")];
        let all = own.into_iter().chain([format!("[::1]:{port}")]).chain(proxy_names.iter().cloned());
        Self(all.map(|name| name.to_ascii_lowercase()).collect())
    }

    fn contains(&self, name: &str) -> bool {
        self.0.iter().any(|known| known.eq_ignore_ascii_case(name))
    }
}

/// Adds all checks and the security headers to `router`.
pub fn with_request_checks(router: Router, names: OwnHostNames, access: Arc<AccessControl>) -> Router {
    router
        .layer(DefaultBodyLimit::max(MAX_REQUEST_BODY_BYTES))
        .layer(from_fn_with_state(access, check_access))
        .layer(from_fn_with_state(names, check_headers_and_limit_time))
        .layer(from_fn(add_security_headers))
}

/// Refuses a request that is not for this server or comes from another site, and limits the time of a request that
/// changes something.
async fn check_headers_and_limit_time(State(names): State<OwnHostNames>, request: Request, next: Next) -> Response {
    if let Err(problem) = check_host_and_origin(&names, &request) {
        return problem.into_response();
    }
    // A request that changes something has a time limit. Any other response may continue, for example an event stream.
    match request.method().is_safe() {
        true => next.run(request).await,
        false => tokio::time::timeout(CHANGING_REQUEST_TIMEOUT, next.run(request)).await.unwrap_or_else(|_| {
            let (status, remedy) = (StatusCode::REQUEST_TIMEOUT, "repeat the request");
            Problem::new(status, "too-slow", "the request was not completed in time", remedy).into_response()
        }),
    }
}

/// Checks that the header Host is a name of this server and, for a request that changes something, that a page of
/// this server or a program has sent the request.
fn check_host_and_origin(names: &OwnHostNames, request: &Request) -> Result<(), Problem> {
    let headers = request.headers();
    let text = |name: HeaderName| headers.get(name).and_then(|value| value.to_str().ok());
    let has_one_host = headers.get_all(HOST).iter().count() == 1;
    let is_own_authority = request.uri().authority().is_none_or(|authority| names.contains(authority.as_str()));
    if !(has_one_host && is_own_authority && text(HOST).is_some_and(|host| names.contains(host))) {
        return Err(Problem::new(
            StatusCode::MISDIRECTED_REQUEST,
            "other-host",
            "the host name of the request is not a name of this server",
            "use the address that the log shows at the start, or add the proxy's host name to `names` \
             of [serve.http]",
        ));
    }
    if request.method().is_safe() {
        return Ok(());
    }
    let is_cross_origin = match text(ORIGIN) {
        Some(origin) => !origin.split_once("://").is_some_and(|(_, host)| names.contains(host)),
        // A browser sends the origin. A program sends the content type JSON, which a form of another site cannot send.
        None => !text(CONTENT_TYPE).is_some_and(|kind| kind.starts_with("application/json")),
    };
    match is_cross_origin {
        false => Ok(()),
        true => Err(Problem::new(
            StatusCode::FORBIDDEN,
            "other-origin",
            "the request does not come from this server's own page",
            "use the page, or send JSON",
        )),
    }
}

async fn add_security_headers(request: Request, next: Next) -> Response {
    let mut response = next.run(request).await;
    let headers = response.headers_mut();
    let mut set = |name: &'static str, value: &'static str| {
        headers.insert(HeaderName::from_static(name), HeaderValue::from_static(value));
    };
    set("content-security-policy", CONTENT_SECURITY_POLICY);
    set("x-content-type-options", "nosniff");
    // The referrer is sent to this origin only. Without a referrer, a browser sends `Origin: null` with a form.
    set("referrer-policy", "same-origin");
    headers.entry(CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    response
}
