//! The page: rendered by the server and readable without a script. The script updates the live part, and removes
//! every value whose source does not respond.

mod compare;
mod machine;
mod middleware;
mod refused;
mod run;
mod runs;
mod schedule;
mod sensors;
mod shared;
mod trends;
mod views;

use std::sync::OnceLock;

use axum::Router;
use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::middleware::from_fn;
use axum::response::{Html, IntoResponse, Redirect, Response};
use axum::routing::get;
use jiff::Timestamp;
use jiff::tz::TimeZone;
use minijinja::{AutoEscape, Environment, UndefinedBehavior, Value, context};

pub use self::middleware::for_people;
pub use self::refused::{as_page, is_json};
pub use self::shared::Shared;
use super::AppState;
use super::problem::Problem;
use crate::store::RunSummary;

const SCRIPT: &str = include_str!("../templates/live.js");
const ICON: &str = include_str!("../templates/icon.svg");
const TEMPLATES: [(&str, &str); 15] = [
    ("base.html", include_str!("../templates/base.html")),
    ("machines.html", include_str!("../templates/machines.html")),
    ("overview.html", include_str!("../templates/overview.html")),
    ("machine.html", include_str!("../templates/machine.html")),
    ("actions.html", include_str!("../templates/actions.html")),
    ("schedule.html", include_str!("../templates/schedule.html")),
    ("live.html", include_str!("../templates/live.html")),
    ("sensors.html", include_str!("../templates/sensors.html")),
    ("views.html", include_str!("../templates/views.html")),
    ("runs.html", include_str!("../templates/runs.html")),
    ("runs_table.html", include_str!("../templates/runs_table.html")),
    ("run.html", include_str!("../templates/run.html")),
    ("compare.html", include_str!("../templates/compare.html")),
    ("refused.html", include_str!("../templates/refused.html")),
    ("login.html", include_str!("../templates/login.html")),
];

pub fn routes() -> Router<AppState> {
    let pages = Router::new()
        .route("/", get(machines))
        .route("/machines", get(overview))
        .route("/machines/{name}", get(machine::page))
        .route("/machines/{name}/live", get(machine::live))
        .route("/machines/{name}/sensors", get(sensors::page))
        .route("/runs", get(runs::page))
        .route("/runs/{run}", get(run::page))
        .route("/runs/{run}/report", get(run::whole))
        .route("/compare", get(compare::page));
    let pages = pages.layer(from_fn(for_people));
    pages.route("/live.js", get(script)).route("/favicon.ico", get(icon))
}

/// Path of a machine's page. A machine's name may contain any character.
pub fn address(machine: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.~".contains(&byte);
    let escaped = machine.bytes().map(|byte| match plain(byte) {
        true => char::from(byte).to_string(),
        false => format!("%{byte:02X}"),
    });
    format!("/machines/{}", escaped.collect::<String>())
}

pub fn render(name: &str, values: Value) -> Result<Html<String>, Problem> {
    Ok(Html(environment()?.get_template(name)?.render(values)?))
}

/// Renders a complete page with its header and navigation. `tokens`: whether tokens are required, so that the page
/// has a link to sign in.
pub fn whole(name: &str, tokens: bool, values: Value) -> Result<Html<String>, Problem> {
    render(name, context! { tokens, ..values })
}

/// The templates, parsed once.
fn environment() -> Result<&'static Environment<'static>, minijinja::Error> {
    static READ: OnceLock<Environment<'static>> = OnceLock::new();
    if let Some(environment) = READ.get() {
        return Ok(environment);
    }
    let mut environment = Environment::new();
    environment.set_undefined_behavior(UndefinedBehavior::Strict);
    environment.set_auto_escape_callback(|_| AutoEscape::Html);
    for (name, text) in TEMPLATES {
        environment.add_template(name, text)?;
    }
    Ok(READ.get_or_init(|| environment))
}

async fn script() -> impl IntoResponse {
    ([(CONTENT_TYPE, "text/javascript; charset=utf-8")], SCRIPT)
}

async fn icon() -> impl IntoResponse {
    ([(CONTENT_TYPE, "image/svg+xml")], ICON)
}

/// Overview of the machines; redirects to the machine's page if there is only one.
async fn machines(State(web): State<AppState>) -> Result<Response, Problem> {
    if let [only] = &*web.machines {
        return Ok(Redirect::to(&address(&only.name)).into_response());
    }
    let tokens = web.access.demanded();
    Ok(whole("machines.html", tokens, standings(&web))?.into_response())
}

/// Live part of the overview, for the script.
async fn overview(State(web): State<AppState>) -> Result<Html<String>, Problem> {
    render("overview.html", standings(&web))
}

fn standings(web: &AppState) -> Value {
    let machines: Vec<Value> = web.machines.iter().map(machine::standing).collect();
    context! { machines, now => moment(Timestamp::now()) }
}

fn row(run: &RunSummary) -> Value {
    context! {
        id => run.id.0,
        started => moment(run.started),
        method => run.method.as_str(),
        machine => run.machine.as_str(),
        state => run.state.as_str(),
        signed => run.signed.as_deref(),
    }
}

/// Local date and time of this computer.
fn moment(at: Timestamp) -> String {
    at.to_zoned(TimeZone::system()).strftime("%Y-%m-%d %H:%M:%S").to_string()
}
