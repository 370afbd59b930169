//! Authentication and authorisation. Without tokens any local user has full control: loopback connections are not
//! authenticated. With `tokens = true` every client presents a token: a program with each request, a browser once
//! for a session.

mod login;
mod rate;
mod roles;
mod secret;
mod session;
mod tokens;

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use axum::extract::{ConnectInfo, MatchedPath, Request, State};
use axum::http::header::{
    ACCEPT, AUTHORIZATION, COOKIE, HOST, HeaderName, HeaderValue, RETRY_AFTER, WWW_AUTHENTICATE,
};
use axum::http::{HeaderMap, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Redirect, Response};
use cookie::Cookie;

pub use self::login::routes;
use self::rate::{Rates, TooOften};
pub use self::roles::Role;
use self::roles::{DOOR, HOLD, needed};
use self::session::Sessions;
use self::tokens::whose;
pub use self::tokens::{Token, TokenError, Tokens};
use super::page::{as_page, is_json};
use super::problem::Problem;
use crate::service::Log;
use crate::service::config::Http;

/// Name of the session cookie.
const SESSION: &str = "trued";
/// Maximum number of session cookies that are read. A browser sends several cookies of one name if other servers on
/// the same host have set theirs (RFC 6265, 5.4).
const MAX_SESSION_COOKIES: usize = 8;

/// Access control of all requests.
pub struct Access {
    demanded: bool,
    /// Host names under which a proxy with TLS receives requests.
    names: Vec<String>,
    tokens: Tokens,
    sessions: Sessions,
    rates: Rates,
    /// The last logged reason why the tokens cannot be read; `None` while they can.
    trouble: Mutex<Option<String>>,
    log: Log,
}

/// Client of a request: the owner of a token or, where none is required, a user on this computer.
#[derive(Clone)]
pub struct Caller {
    token: Option<Token>,
    /// Key of the rate limit: the token's name, or the address.
    counts: String,
    access: Arc<Access>,
}

/// Client of a request, as an extension of the response: token and address, so that tablets that share one token
/// are distinguished.
#[derive(Clone)]
pub struct ClientIdentity(pub String);

impl Caller {
    /// Name for the audit log: the token's name and the name that the person typed; at least one of them.
    ///
    /// # Errors
    /// There is neither a token nor a valid typed name.
    pub fn signs(&self, typed: &str) -> Result<String, Problem> {
        let typed = typed.trim();
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
            "nobody has given a name",
            "say who you are: it stands in the log of this machine",
        ))
    }

    /// Name for the log, where a name is not required.
    pub fn is_called(&self, typed: &str) -> String {
        let somebody = || self.token.as_ref().map_or("somebody at the page", |token| &token.name);
        self.signs(typed).unwrap_or_else(|_| somebody().to_owned())
    }

    /// Whether the client has a token; without one it is admitted only if tokens are not required.
    pub fn has_token(&self) -> bool {
        self.token.is_some()
    }

    /// Whether the client's token is still valid and not revoked.
    pub fn stands(&self) -> bool {
        let known = || self.access.known().unwrap_or_default();
        self.token.as_ref().is_none_or(|token| known().contains(token))
    }

    /// Key of the client's rate limit.
    pub fn counts_as(&self) -> &str {
        &self.counts
    }

    /// Counts a hold of the client; returns whether its holds are too frequent to log each one.
    pub fn holds_often(&self) -> bool {
        self.access.rates.hold(&self.counts).is_err()
    }
}

/// Why a request is not admitted.
enum Refused {
    Unknown,
    Lesser(Role),
    TooOften(TooOften),
    /// The tokens cannot be read.
    Closed,
}

impl From<TooOften> for Refused {
    fn from(too_often: TooOften) -> Self {
        Self::TooOften(too_often)
    }
}

impl Access {
    /// `folder`: folder of the journal.
    ///
    /// # Errors
    /// Tokens are required and cannot be read.
    pub fn new(config: &Http, folder: &Path, log: &Log) -> Result<Arc<Self>, TokenError> {
        let tokens = Tokens::beside(folder);
        if config.tokens && tokens.all()?.is_empty() {
            log.say(
                "there is no token yet, and nobody gets in without one: `trued token add NAME --role ROLE`",
            );
        }
        let (demanded, names) = (config.tokens, config.names.clone());
        let (sessions, rates, log) = (Sessions::default(), Rates::default(), log.clone());
        let trouble = Mutex::default();
        Ok(Arc::new(Self { demanded, names, tokens, sessions, rates, trouble, log }))
    }

    /// The valid tokens. If they cannot be read, no client is admitted, and the log reports it once.
    fn known(&self) -> Result<Vec<Token>, TokenError> {
        let known = self.tokens.all();
        let trouble = known.as_ref().err().map(|error| format!("{error}; {}", error.remedy()));
        let mut told = self.trouble.lock().unwrap_or_else(PoisonError::into_inner);
        if *told != trouble {
            match &trouble {
                Some(why) => {
                    self.log.fault(&format!("the tokens cannot be read, nobody gets in: {why}"))
                }
                None => self.log.say("the tokens can be read again"),
            }
            *told = trouble;
        }
        known
    }

    /// Whether every client must present a token.
    pub fn demanded(&self) -> bool {
        self.demanded
    }

    fn judge(self: &Arc<Self>, request: &Request) -> Result<Caller, Refused> {
        let route = request.extensions().get::<MatchedPath>().map_or("", MatchedPath::as_str);
        let (reads, address) = (request.method().is_safe(), self.address(request));
        let token = match self.demanded && route != DOOR {
            true => Some(self.token(request.headers(), &address, route)?),
            false => None,
        };
        let least = needed(route, reads);
        if token.as_ref().is_some_and(|token| token.role < least) {
            return Err(Refused::Lesser(least));
        }
        let counts = token.as_ref().map_or(address, |token| token.name.clone());
        if !reads && route != HOLD {
            self.rates.change(&counts)?;
        }
        Ok(Caller { token, counts, access: Arc::clone(self) })
    }

    fn token(&self, headers: &HeaderMap, address: &str, route: &str) -> Result<Token, Refused> {
        let shown = text(headers, AUTHORIZATION).map(bearer);
        let known = match self.known() {
            Ok(known) => known,
            // A token of the last successful read may still hold the machine: a hold causes no motion.
            Err(_) if route == HOLD => self.tokens.last(),
            Err(_) => return Err(Refused::Closed),
        };
        let token = match shown {
            Some(shown) => shown.and_then(|shown| whose(&known, shown)),
            None => {
                let numbers = session_numbers(headers);
                if numbers.is_empty() {
                    return Err(Refused::Unknown);
                }
                let mut tokens = numbers.iter().filter_map(|number| self.sessions.find(number));
                tokens.find(|token| known.contains(token))
            }
        };
        match token {
            Some(token) => Ok(token),
            None => {
                self.rates.failure(address)?;
                self.log.say(&format!("{address} has shown what is no token"));
                Err(Refused::Unknown)
            }
        }
    }

    /// Address of the client; behind a proxy on this computer, the last address in its `X-Forwarded-For` header.
    fn address(&self, request: &Request) -> String {
        let peer = request.extensions().get::<ConnectInfo<SocketAddr>>();
        let peer = peer.map_or(IpAddr::V4(Ipv4Addr::UNSPECIFIED), |info| info.0.ip());
        let told = text(request.headers(), HeaderName::from_static("x-forwarded-for"));
        let last = told.and_then(|all| all.rsplit(',').next()?.trim().parse::<IpAddr>().ok());
        let named = last.filter(|_| !self.names.is_empty() && peer.is_loopback());
        named.unwrap_or(peer).to_string()
    }

    /// Whether the request came through the proxy. A browser returns a secure cookie only under the proxy's name.
    fn is_behind_proxy(&self, headers: &HeaderMap) -> bool {
        let host = text(headers, HOST).unwrap_or("");
        self.names.iter().any(|name| name.eq_ignore_ascii_case(host))
    }
}

fn text(headers: &HeaderMap, name: HeaderName) -> Option<&str> {
    headers.get(name).and_then(|value| value.to_str().ok())
}

fn bearer(authorization: &str) -> Option<&str> {
    let (scheme, token) = authorization.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}

/// The values of the session cookies, valid or not.
fn session_numbers(headers: &HeaderMap) -> Vec<String> {
    let cookies = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
    let cookies = cookies.flat_map(Cookie::split_parse).filter_map(Result::ok);
    let named = cookies.filter(|cookie| cookie.name() == SESSION).take(MAX_SESSION_COOKIES);
    named.map(|cookie| cookie.value().to_owned()).collect()
}

/// Middleware that admits or refuses each request.
pub async fn admit(
    State(access): State<Arc<Access>>,
    mut request: Request,
    next: Next,
) -> Response {
    let refused = match access.judge(&request) {
        Ok(caller) => {
            let asker = ClientIdentity(format!("{} {}", caller.counts, access.address(&request)));
            request.extensions_mut().insert(caller);
            let mut response = next.run(request).await;
            response.extensions_mut().insert(asker);
            return response;
        }
        Err(refused) => refused,
    };
    let reads = request.method().is_safe();
    match refused {
        refused if !is_for_a_person(&request) => refused.into_response(),
        Refused::Unknown if reads => Redirect::to(DOOR).into_response(),
        Refused::Unknown => as_page(signed_out().into_response(), access.demanded).await,
        refused => as_page(refused.into_response(), access.demanded).await,
    }
}

/// Whether the request comes from a browser: a page, or a form sent to a route where programs send JSON.
fn is_for_a_person(request: &Request) -> bool {
    let accepts = text(request.headers(), ACCEPT).unwrap_or("");
    let api = request.uri().path().starts_with("/api/");
    let program = if request.method().is_safe() { api } else { is_json(request.headers()) };
    !program && accepts.contains("text/html")
}

impl IntoResponse for Refused {
    fn into_response(self) -> Response {
        match self {
            Self::Unknown => {
                let mut response = Problem::new(
                    StatusCode::UNAUTHORIZED,
                    "no-token",
                    "this server answers to tokens only",
                    "send `Authorization: Bearer TOKEN`, or come in at /login; `trued token add` makes one",
                )
                .into_response();
                let bearer = HeaderValue::from_static("Bearer");
                response.headers_mut().insert(WWW_AUTHENTICATE, bearer);
                response
            }
            Self::Lesser(least) => Problem::new(
                StatusCode::FORBIDDEN,
                "wrong-role",
                format!("this is for a token of role {least}, or more"),
                "ask somebody who has one, or sign in with such a token",
            )
            .into_response(),
            Self::TooOften(TooOften(wait)) => too_often(wait).into_response(),
            Self::Closed => closed().into_response(),
        }
    }
}

fn signed_out() -> Problem {
    Problem::new(
        StatusCode::UNAUTHORIZED,
        "no-token",
        "nobody is signed in here, or not any more: nothing was done",
        "sign in, then do it again",
    )
}

fn closed() -> Problem {
    Problem::new(
        StatusCode::SERVICE_UNAVAILABLE,
        "tokens-unreadable",
        "the list of tokens cannot be read, so that nobody is let in",
        "whoever looks after this computer finds why in the log; a hold still goes",
    )
}

fn too_often(wait: Duration) -> impl IntoResponse {
    let seconds = wait.as_secs() + 1;
    let problem = Problem::new(
        StatusCode::TOO_MANY_REQUESTS,
        "too-often",
        "that is asked for too often",
        format!("wait {seconds} s; a hold needs not wait"),
    );
    ([(RETRY_AFTER, HeaderValue::from(seconds))], problem)
}
