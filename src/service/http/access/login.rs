//! Sign-in and sign-out at the page.

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
use super::tokens::whose;
use super::{Access, DOOR, Refused, SESSION, closed, session_numbers};
use crate::service::http::AppState;
use crate::service::http::page::{for_people, whole};
use crate::service::http::problem::Problem;

pub fn routes() -> Router<AppState> {
    let routes = Router::new().route(DOOR, get(door).post(enter)).route("/logout", post(leave));
    // These routes are for browsers only.
    routes.layer(from_fn(for_people))
}

#[derive(Deserialize)]
struct LoginForm {
    token: String,
}

async fn door(State(web): State<AppState>, headers: HeaderMap) -> Result<Html<String>, Problem> {
    let access = &web.access;
    let numbers = session_numbers(&headers);
    let inside = numbers.iter().find_map(|number| access.sessions.find(number));
    let (name, role) = match &inside {
        Some(token) => (Some(token.name.as_str()), Some(token.role.as_str())),
        None => (None, None),
    };
    whole("login.html", access.demanded, context! { name, role, wrong => false })
}

async fn enter(State(web): State<AppState>, request: Request) -> Result<Response, Problem> {
    let (access, headers) = (&web.access, request.headers().clone());
    let address = access.address(&request);
    let form = Form::from_request(request, &web).await;
    let Form(LoginForm { token }) = form.map_err(|_| unreadable())?;
    let known = access.known().map_err(|_| closed())?;
    let Some(token) = whose(&known, token.trim()) else {
        if let Err(too_often) = access.rates.failure(&address) {
            return Ok(Refused::from(too_often).into_response());
        }
        access.log.say(&format!("{address} has shown what is no token"));
        let values = context! { name => (), role => (), wrong => true };
        let door = whole("login.html", access.demanded, values)?;
        return Ok((StatusCode::UNAUTHORIZED, door).into_response());
    };
    access.log.say(&format!("{} comes in from {address}", token.name));
    let number = access.sessions.open(token).map_err(no_chance)?;
    let lasts = time::Duration::seconds(SESSION_DURATION.as_secs() as i64);
    Ok(with_cookie(access, &headers, number, lasts, "/"))
}

async fn leave(State(web): State<AppState>, headers: HeaderMap) -> Response {
    for number in session_numbers(&headers) {
        web.access.sessions.close(&number);
    }
    with_cookie(&web.access, &headers, String::new(), time::Duration::ZERO, DOOR)
}

fn with_cookie(
    access: &Access,
    headers: &HeaderMap,
    number: String,
    lasts: time::Duration,
    to: &str,
) -> Response {
    let cookie = Cookie::build((SESSION, number))
        .path("/")
        .http_only(true)
        .same_site(SameSite::Strict)
        .secure(access.is_behind_proxy(headers))
        .max_age(lasts)
        .build();
    let mut response = Redirect::to(to).into_response();
    if let Ok(value) = HeaderValue::from_str(&cookie.to_string()) {
        response.headers_mut().insert(SET_COOKIE, value);
    }
    response
}

fn unreadable() -> Problem {
    let (status, remedy) = (StatusCode::BAD_REQUEST, "come in at /login");
    Problem::new(status, "unreadable", "no token came with the form", remedy)
}

fn no_chance(error: getrandom::Error) -> Problem {
    let status = StatusCode::INTERNAL_SERVER_ERROR;
    let told = super::TokenError::from(error);
    Problem::new(status, "no-random", told.to_string(), told.remedy())
}
