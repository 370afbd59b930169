//! The web page: rendered by the server and readable without a script. The script updates the live part, and removes
//! every value whose source does not respond.

mod audit;
mod compare;
mod compensation;
mod error_page;
mod error_page_middleware;
mod machine;
mod rendering_cache;
mod run;
mod run_drawings;
mod runs;
mod schedule;
mod sensors;
mod trends;

use std::sync::LazyLock;

use axum::Router;
use axum::extract::State;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::middleware::from_fn;
use axum::response::{Html, IntoResponse, Redirect, Response};
use axum::routing::get;
use include_dir::{Dir, File, include_dir};
use jiff::Timestamp;
use minijinja::value::Serde;
use minijinja::{AutoEscape, Environment, UndefinedBehavior, Value, context};

pub use self::error_page::{error_page, has_json_content_type};
pub use self::error_page_middleware::errors_as_pages;
pub use self::rendering_cache::RenderingCache;
use super::percent_encode::percent_encode;
use super::problem::Problem;
use super::{AppState, ServedMachine};
use crate::report::BASE_CSS;
use crate::report::number::with_one_line_symbols;
use crate::report::result_row::{verdict_class, verdict_word};
use crate::report::time::format_local_time;
use crate::service::machine_state::ServiceState;
use crate::store::{RunState, RunSummary, sha256_text};

const LIVE_SCRIPT: &str = include_str!("../templates/live.js");
const ICON_SVG: &str = include_str!("../templates/icon.svg");
static TEMPLATE_FOLDER: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/src/service/http/templates");

pub fn page_routes() -> Router<AppState> {
    let pages = Router::new()
        .route("/", get(machines_page))
        .route("/machines", get(overview_part))
        .route("/machines/{name}", get(machine::machine_page))
        .route("/machines/{name}/live", get(machine::live_part))
        .route("/machines/{name}/sensors", get(sensors::sensors_part))
        .route("/runs", get(runs::runs_page))
        .route("/audit", get(audit::audit_page))
        .route("/runs/{run}", get(run::run_page))
        .route("/runs/{run}/report", get(run::report_page))
        .route("/runs/{run}/compensation", get(compensation::proposal_page))
        .route("/runs/{run}/verification", get(compensation::verification_page))
        .route("/runs/{run}/sheet", get(compensation::sheet_page))
        .route("/compare", get(compare::compare_page));
    let pages = pages.layer(from_fn(errors_as_pages));
    pages.route("/live.js", get(serve_live_script)).route("/favicon.ico", get(serve_icon))
}

/// Path of a machine's page. A machine's name may contain any character.
pub fn machine_page_path(machine: &str) -> String {
    format!("/machines/{}", percent_encode(machine))
}

pub fn render_template(template: &str, values: Value) -> Result<Html<String>, Problem> {
    Ok(Html(TEMPLATES.get_template(template)?.render(values)?))
}

/// Renders a complete page with its header and navigation. `has_sign_in_link`: whether the page has a link to sign in,
/// which is of use only where tokens are required.
pub fn render_page(template: &str, has_sign_in_link: bool, values: Value) -> Result<Html<String>, Problem> {
    render_template(template, context! { tokens => has_sign_in_link, ..values })
}

/// The templates, each parsed at its first use.
static TEMPLATES: LazyLock<Environment<'_>> = LazyLock::new(|| {
    let mut environment = Environment::new();
    environment.set_undefined_behavior(UndefinedBehavior::Strict);
    environment.set_auto_escape_callback(|_| AutoEscape::Html);
    environment.set_loader(|name| {
        let file = TEMPLATE_FOLDER.get_file(name).and_then(File::contents_utf8);
        Ok(file.map(str::to_owned))
    });
    environment.add_filter("one_line_symbols", with_one_line_symbols);
    environment.add_global("base_css", Value::from_safe_string(BASE_CSS.to_owned()));
    environment.add_global("live_script", format!("/live.js?{}", sha256_text(LIVE_SCRIPT)));
    environment
});

/// The browser keeps the script: a page that is loaded just before the service ends can then still reconnect. The
/// address contains the hash of the script.
async fn serve_live_script() -> impl IntoResponse {
    (
        [(CONTENT_TYPE, "text/javascript; charset=utf-8"), (CACHE_CONTROL, "private, max-age=31536000, immutable")],
        LIVE_SCRIPT,
    )
}

async fn serve_icon() -> impl IntoResponse {
    ([(CONTENT_TYPE, "image/svg+xml")], ICON_SVG)
}

/// Overview of the machines; redirects to the machine's page if there is only one.
async fn machines_page(State(app): State<AppState>) -> Result<Response, Problem> {
    if let [only] = &*app.machines {
        return Ok(Redirect::to(&machine_page_path(&only.name)).into_response());
    }
    let tokens = app.access.requires_tokens;
    Ok(render_page("machines.html", tokens, overview_values(&app))?.into_response())
}

/// Live part of the overview, for the script.
async fn overview_part(State(app): State<AppState>) -> Result<Html<String>, Problem> {
    render_template("overview.html", overview_values(&app))
}

fn overview_values(app: &AppState) -> Value {
    let machines: Vec<Value> = app.machines.iter().map(machine::status_values).collect();
    context! { machines, now => format_local_time(Timestamp::now()) }
}

/// Row of `run` in a list; `machine`: the machine of the run, if it is served. When a run is resumed, the machine
/// state shows `running` earlier than the journal.
fn row_of_run_on(machine: Option<&ServedMachine>, run: &RunSummary) -> Value {
    let in_progress = machine.map(|machine| machine.gate.machine_state());
    let is_in_progress =
        in_progress.is_some_and(|now| now.state == ServiceState::Running && i64::from(now.run) == run.id.0);
    match is_in_progress {
        true => context! { state => RunState::Running.as_str(), end_reason => (), ..row_of_run(run) },
        false => row_of_run(run),
    }
}

fn row_of_run(run: &RunSummary) -> Value {
    context! {
        started => format_local_time(run.started),
        verdict_class => run.verdict.map(verdict_class),
        verdict_word => run.verdict.map(verdict_word),
        ..Serde(run)
    }
}
