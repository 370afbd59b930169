//! Authentication and authorisation. Without tokens any local user has full control: loopback connections are not
//! authenticated. With `tokens = true` every client presents a token: a program with each request, a browser once
//! for a session.

mod login;
mod rate_limit;
mod roles;
mod session;
mod tokens;

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::extract::{ConnectInfo, MatchedPath, Request, State};
use axum::http::header::{ACCEPT, AUTHORIZATION, COOKIE, HOST, HeaderName, HeaderValue, RETRY_AFTER, WWW_AUTHENTICATE};
use axum::http::{HeaderMap, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Redirect, Response};
use cookie::Cookie;

pub use self::login::login_routes;
use self::rate_limit::{RateLimitExceeded, RateLimits};
pub use self::roles::Role;
use self::roles::{HOLD_ROUTE, LOGIN_ROUTE, required_role};
use self::session::Sessions;
use self::tokens::find_token;
pub use self::tokens::{Token, TokenError, TokenStore};
use super::page::{error_page, has_json_content_type};
use super::problem::Problem;
use crate::service::config::HttpConfig;
use crate::service::{Log, lock};

/// Name of the session cookie.
const SESSION_COOKIE_NAME: &str = "trued";
/// Maximum number of session cookies that are read. A browser sends several cookies of one name if other servers on
/// the same host have set theirs (RFC 6265, 5.4).
const MAX_COOKIES_READ_PER_REQUEST: usize = 8;

/// Access control of all requests.
pub struct AccessControl {
    /// Whether every client must present a token.
    pub requires_tokens: bool,
    /// Host names under which a proxy with TLS receives requests.
    proxy_names: Vec<String>,
    token_store: TokenStore,
    sessions: Sessions,
    rate_limits: RateLimits,
    /// The last logged reason why the tokens cannot be read; `None` while they can.
    logged_token_error: Mutex<Option<String>>,
    log: Log,
}

/// Client of a request: the owner of a token or, where none is required, a user on this computer.
#[derive(Clone)]
pub struct Caller {
    /// `None`: tokens are not required, or the request is for the sign-in page.
    token: Option<Token>,
    /// Key of the rate limit: the token's name, or the address.
    pub rate_limit_key: String,
    access: Arc<AccessControl>,
}

/// Client of a request, as an extension of the response: token and address, so that tablets that share one token
/// are distinguished.
#[derive(Clone)]
pub struct ClientIdentity(pub String);

impl Caller {
    /// Name for the audit log: the token's name and the name that the person typed; at least one of them.
    ///
    /// # Errors
    /// There is neither a token nor a typed name, or the typed name is invalid (over 100 characters, or with control
    /// characters).
    pub fn audit_name(&self, typed_name: &str) -> Result<String, Problem> {
        let typed = typed_name.trim();
        let unfit = typed.chars().count() > 100 || typed.chars().any(char::is_control);
        match (&self.token, typed) {
            (None, "") => {}
            (Some(token), "") => return Ok(token.name.clone()),
            _ if unfit => {}
            (None, typed) => return Ok(typed.to_owned()),
            (Some(token), typed) => return Ok(format!("{}: {typed}", token.name)),
        }
        Err(Problem::new(
            StatusCode::BAD_REQUEST,
            "nameless",
            "the request contains no valid name",
            "enter your name; the audit log of the machine records it",
        ))
    }

    /// Name for the log, where a name is not required.
    pub fn log_name(&self, typed_name: &str) -> String {
        let unsigned_name = || self.token.as_ref().map_or("an unnamed person at the page", |token| &token.name);
        self.audit_name(typed_name).unwrap_or_else(|_| unsigned_name().to_owned())
    }

    /// Whether the client has a token; without one it is admitted only if tokens are not required.
    pub fn has_token(&self) -> bool {
        self.token.is_some()
    }

    /// # Errors
    /// The client has no token of a metrologist.
    pub fn require_metrologist(&self) -> Result<(), Problem> {
        match &self.token {
            Some(token) if token.role == Role::Metrologist => Ok(()),
            _ => Err(Problem::new(
                StatusCode::FORBIDDEN,
                "no-metrologist",
                "only a metrologist may read these values: the control runs a program for it",
                "use the token of a metrologist, or stop the service and use `trued compensate`",
            )),
        }
    }

    /// Whether the client's token is still in the list of tokens; `true` for a client without a token, `false` if the
    /// list cannot be read.
    pub fn is_token_valid(&self) -> bool {
        let known = || self.access.valid_tokens().unwrap_or_default();
        self.token.as_ref().is_none_or(|token| known().contains(token))
    }

    /// Counts a hold of the client; returns whether its holds are too frequent to log each one.
    pub fn has_exceeded_log_rate_with_this_hold(&self) -> bool {
        self.access.rate_limits.hold_log_limit.count_event(&self.rate_limit_key).is_err()
    }
}

/// Why a request is not admitted.
enum AccessDenied {
    /// No token or session, or one that is unknown, expired or revoked.
    NoValidToken,
    /// The request requires this role, or a higher one; the caller has a lower one.
    RequiresRole(Role),
    /// Too many changes by this client, or too many invalid tokens from its address.
    RateLimitExceeded(RateLimitExceeded),
    /// The tokens cannot be read.
    TokensUnreadable,
}

impl AccessControl {
    /// `folder`: folder of the journal.
    ///
    /// # Errors
    /// Tokens are required and cannot be read.
    pub fn new(config: &HttpConfig, folder: &Path, log: &Log) -> Result<Arc<Self>, TokenError> {
        let tokens = TokenStore::in_folder(folder);
        if config.requires_tokens && tokens.read_all()?.is_empty() {
            log.info(
                "no token exists, but access requires one: create a token with `trued token add NAME --role ROLE`",
            );
        }
        Ok(Arc::new(Self {
            requires_tokens: config.requires_tokens,
            proxy_names: config.proxy_names.clone(),
            token_store: tokens,
            sessions: Sessions::default(),
            rate_limits: RateLimits::default(),
            logged_token_error: Mutex::default(),
            log: log.clone(),
        }))
    }

    /// All tokens that are not revoked. If they cannot be read, no client is admitted (except for a hold with a token
    /// of the last successful read), and the log reports it once.
    fn valid_tokens(&self) -> Result<Vec<Token>, TokenError> {
        let known = self.token_store.read_all();
        let trouble = known.as_ref().err().map(|error| format!("{error}; {}", error.remedy()));
        let mut logged_error = lock(&self.logged_token_error);
        if *logged_error != trouble {
            match &trouble {
                Some(why) => self.log.error(&format!("the tokens cannot be read, so access is refused: {why}")),
                None => self.log.info("the tokens can be read again"),
            }
            *logged_error = trouble;
        }
        known
    }

    /// Checks token, role and rate limits of a request. Changes except a hold count for the limit of changes; invalid
    /// tokens count for a limit of their own.
    fn authorize(self: &Arc<Self>, request: &Request) -> Result<Caller, AccessDenied> {
        let route = request.extensions().get::<MatchedPath>().map_or("", MatchedPath::as_str);
        let (is_read_only, address) = (request.method().is_safe(), self.client_address(request));
        let token = match self.requires_tokens && route != LOGIN_ROUTE {
            true => Some(self.authenticate(request.headers(), &address, route)?),
            false => None,
        };
        let required = required_role(route, is_read_only);
        if token.as_ref().is_some_and(|token| token.role < required) {
            return Err(AccessDenied::RequiresRole(required));
        }
        let rate_limit_key = token.as_ref().map_or(address, |token| token.name.clone());
        if !is_read_only && route != HOLD_ROUTE {
            self.rate_limits.change_limit.count_event(&rate_limit_key).map_err(AccessDenied::RateLimitExceeded)?;
        }
        Ok(Caller { token, rate_limit_key, access: Arc::clone(self) })
    }

    /// Token of the `Authorization` header or, only without this header, of a session. An invalid token counts for
    /// the limit of `address`; a request with neither does not.
    fn authenticate(&self, headers: &HeaderMap, address: &str, route: &str) -> Result<Token, AccessDenied> {
        let presented = header_text(headers, AUTHORIZATION).map(bearer_token);
        let known = match self.valid_tokens() {
            Ok(known) => known,
            // A token of the last successful read may still hold the machine: a hold causes no motion.
            Err(_) if route == HOLD_ROUTE => self.token_store.last_read_tokens(),
            Err(_) => return Err(AccessDenied::TokensUnreadable),
        };
        let token = match presented {
            Some(presented) => presented.and_then(|presented| find_token(&known, presented)),
            None => {
                let numbers = session_cookie_values(headers);
                if numbers.is_empty() {
                    return Err(AccessDenied::NoValidToken);
                }
                let mut tokens = numbers.iter().filter_map(|number| self.sessions.find_token(number));
                tokens.find(|token| known.contains(token))
            }
        };
        match token {
            Some(token) => Ok(token),
            None => {
                self.rate_limits.invalid_token_limit.count_event(address).map_err(AccessDenied::RateLimitExceeded)?;
                self.log.info(&format!("{address} presented an invalid token"));
                Err(AccessDenied::NoValidToken)
            }
        }
    }

    /// IP address of the client. The last address in `X-Forwarded-For` replaces it only if proxy names are configured
    /// and the connection comes from this computer.
    fn client_address(&self, request: &Request) -> String {
        let peer = request.extensions().get::<ConnectInfo<SocketAddr>>();
        let peer = peer.map_or(IpAddr::V4(Ipv4Addr::UNSPECIFIED), |info| info.0.ip());
        let forwarded = header_text(request.headers(), HeaderName::from_static("x-forwarded-for"));
        let last = forwarded.and_then(|all| all.rsplit(',').next()?.trim().parse::<IpAddr>().ok());
        let named = last.filter(|_| !self.proxy_names.is_empty() && peer.is_loopback());
        named.unwrap_or(peer).to_string()
    }

    /// Whether the request is addressed to a host name of the proxy (header Host, which a client can choose). A
    /// browser returns a secure cookie only under the proxy's name.
    fn is_request_through_proxy(&self, headers: &HeaderMap) -> bool {
        let host = header_text(headers, HOST).unwrap_or("");
        self.proxy_names.iter().any(|name| name.eq_ignore_ascii_case(host))
    }
}

fn header_text(headers: &HeaderMap, name: HeaderName) -> Option<&str> {
    headers.get(name).and_then(|value| value.to_str().ok())
}

/// Token in the value of an `Authorization` header; `None` for another scheme than Bearer.
fn bearer_token(authorization: &str) -> Option<&str> {
    let (scheme, token) = authorization.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}

/// The values of the session cookies, valid or not; the first [`MAX_COOKIES_READ_PER_REQUEST`] of them.
fn session_cookie_values(headers: &HeaderMap) -> Vec<String> {
    let cookies = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
    let cookies = cookies.flat_map(Cookie::split_parse).filter_map(Result::ok);
    let named = cookies.filter(|cookie| cookie.name() == SESSION_COOKIE_NAME).take(MAX_COOKIES_READ_PER_REQUEST);
    named.map(|cookie| cookie.value().to_owned()).collect()
}

/// Middleware that admits or refuses each request.
pub async fn check_access(State(access): State<Arc<AccessControl>>, mut request: Request, next: Next) -> Response {
    let refused = match access.authorize(&request) {
        Ok(caller) => {
            let client = ClientIdentity(format!("{} {}", caller.rate_limit_key, access.client_address(&request)));
            request.extensions_mut().insert(caller);
            let mut response = next.run(request).await;
            response.extensions_mut().insert(client);
            return response;
        }
        Err(refused) => refused,
    };
    let is_read_only = request.method().is_safe();
    match refused {
        refused if !is_browser_request(&request) => refused.into_response(),
        AccessDenied::NoValidToken if is_read_only => Redirect::to(LOGIN_ROUTE).into_response(),
        AccessDenied::NoValidToken => error_page(not_signed_in_problem().into_response(), access.requires_tokens).await,
        refused => error_page(refused.into_response(), access.requires_tokens).await,
    }
}

/// Whether the response should be a page: the client accepts HTML, and the request is neither a read of `/api/` nor a
/// change sent as JSON.
fn is_browser_request(request: &Request) -> bool {
    let accepts = header_text(request.headers(), ACCEPT).unwrap_or("");
    let api = request.uri().path().starts_with("/api/");
    let program = if request.method().is_safe() { api } else { has_json_content_type(request.headers()) };
    !program && accepts.contains("text/html")
}

impl IntoResponse for AccessDenied {
    fn into_response(self) -> Response {
        match self {
            AccessDenied::NoValidToken => {
                let problem = Problem::new(
                    StatusCode::UNAUTHORIZED,
                    "no-token",
                    "this server requires a token",
                    "send `Authorization: Bearer TOKEN`, or sign in at /login; `trued token add` creates a token",
                );
                ([(WWW_AUTHENTICATE, "Bearer")], problem).into_response()
            }
            AccessDenied::RequiresRole(required) => Problem::new(
                StatusCode::FORBIDDEN,
                "wrong-role",
                format!("this request requires a token of role {required} or higher"),
                "sign in with such a token, or ask a person who has one",
            )
            .into_response(),
            Self::RateLimitExceeded(RateLimitExceeded(wait)) => rate_limited_response(wait).into_response(),
            Self::TokensUnreadable => tokens_unreadable_problem().into_response(),
        }
    }
}

fn not_signed_in_problem() -> Problem {
    Problem::new(
        StatusCode::UNAUTHORIZED,
        "no-token",
        "no user is signed in, or the session has expired: the request was not executed",
        "sign in, then repeat the request",
    )
}

fn tokens_unreadable_problem() -> Problem {
    Problem::new(
        StatusCode::SERVICE_UNAVAILABLE,
        "tokens-unreadable",
        "the list of tokens cannot be read, so access is refused",
        "ask the administrator of this computer to read the log; a hold is still possible",
    )
}

fn rate_limited_response(wait: Duration) -> impl IntoResponse {
    let seconds = wait.as_secs() + 1;
    let problem = Problem::new(
        StatusCode::TOO_MANY_REQUESTS,
        "too-often",
        "too many requests",
        format!("wait {seconds} s; a hold is not limited"),
    );
    ([(RETRY_AFTER, HeaderValue::from(seconds))], problem)
}
