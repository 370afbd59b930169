//! Sign-in and sign-out at the web page.

use axum::extract::{FromRequest, Request, State};
use axum::http::header::{HeaderValue, SET_COOKIE};
use axum::http::{HeaderMap, StatusCode};
use axum::middleware::from_fn;
use axum::response::{Html, IntoResponse, Redirect, Response};
use axum::routing::{get, post};
use axum::{Form, Router};
use cookie::{Cookie, SameSite, time};
use minijinja::context;
use serde::Deserialize;

use super::session::SESSION_DURATION;
use super::tokens::find_token;
use super::{
    AccessControl, AccessDenied, LOGIN_ROUTE, SESSION_COOKIE_NAME, session_cookie_values, tokens_unreadable_problem,
};
use crate::service::http::AppState;
use crate::service::http::page::{errors_as_pages, render_page};
use crate::service::http::problem::Problem;

pub fn login_routes() -> Router<AppState> {
    let routes = Router::new().route(LOGIN_ROUTE, get(login_page).post(sign_in)).route("/logout", post(sign_out));
    // These routes are for browsers only.
    routes.layer(from_fn(errors_as_pages))
}

#[derive(Deserialize)]
struct LoginForm {
    /// Secret of the token, as `trued token add` has printed it.
    token: String,
}

async fn login_page(State(app): State<AppState>, headers: HeaderMap) -> Result<Html<String>, Problem> {
    let access = &app.access;
    let numbers = session_cookie_values(&headers);
    let session_token = numbers.iter().find_map(|number| access.sessions.find_token(number));
    let (name, role) = session_token.as_ref().map(|token| (token.name.as_str(), token.role.as_str())).unzip();
    render_page("login.html", access.requires_tokens, context! { name, role, wrong => false })
}

async fn sign_in(State(app): State<AppState>, request: Request) -> Result<Response, Problem> {
    let (access, headers) = (&app.access, request.headers().clone());
    let address = access.client_address(&request);
    let form = Form::from_request(request, &app).await;
    let Form(LoginForm { token }) = form.map_err(|_| missing_token_field_problem())?;
    let known = access.valid_tokens().map_err(|_| tokens_unreadable_problem())?;
    let Some(token) = find_token(&known, token.trim()) else {
        if let Err(too_often) = access.rate_limits.invalid_token_limit.count_event(&address) {
            return Ok(AccessDenied::RateLimitExceeded(too_often).into_response());
        }
        access.log.info(&format!("{address} presented an invalid token"));
        let values = context! { name => (), role => (), wrong => true };
        let login_page = render_page("login.html", access.requires_tokens, values)?;
        return Ok((StatusCode::UNAUTHORIZED, login_page).into_response());
    };
    access.log.info(&format!("{} signed in from {address}", token.name));
    let number = access.sessions.open(token).map_err(no_random_numbers_problem)?;
    let max_age = time::Duration::seconds(SESSION_DURATION.as_secs() as i64);
    Ok(redirect_with_cookie(access, &headers, number, max_age, "/"))
}

async fn sign_out(State(app): State<AppState>, headers: HeaderMap) -> Response {
    for number in session_cookie_values(&headers) {
        app.access.sessions.close(&number);
    }
    redirect_with_cookie(&app.access, &headers, String::new(), time::Duration::ZERO, LOGIN_ROUTE)
}

/// Redirects to `location` and sets the session cookie; `max_age` 0 deletes the cookie.
fn redirect_with_cookie(
    access: &AccessControl,
    headers: &HeaderMap,
    session_number: String,
    max_age: time::Duration,
    location: &str,
) -> Response {
    let cookie = Cookie::build((SESSION_COOKIE_NAME, session_number))
        .path("/")
        .http_only(true)
        .same_site(SameSite::Strict)
        .secure(access.is_request_through_proxy(headers))
        .max_age(max_age)
        .build();
    let mut response = Redirect::to(location).into_response();
    if let Ok(value) = HeaderValue::from_str(&cookie.to_string()) {
        response.headers_mut().insert(SET_COOKIE, value);
    }
    response
}

fn missing_token_field_problem() -> Problem {
    let (status, remedy) = (StatusCode::BAD_REQUEST, "sign in at /login");
    Problem::new(status, "unreadable", "the form contains no token", remedy)
}

fn no_random_numbers_problem(error: getrandom::Error) -> Problem {
    let status = StatusCode::INTERNAL_SERVER_ERROR;
    let error = super::TokenError::from(error);
    Problem::new(status, "no-random", error.to_string(), error.remedy())
}
