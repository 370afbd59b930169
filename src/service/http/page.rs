//! The page: server-rendered, readable without a script; the script brings the live part up to date and
//! takes every value away whose source does not answer.

use std::sync::OnceLock;

use axum::Router;
use axum::extract::{Path, State};
use axum::http::header::CONTENT_TYPE;
use axum::response::{Html, IntoResponse, Redirect, Response};
use axum::routing::get;
use jiff::Timestamp;
use jiff::tz::TimeZone;
use minijinja::{AutoEscape, Environment, UndefinedBehavior, Value, context};

use super::api::look;
use super::problem::Problem;
use super::standing::Standing;
use super::{Shown, Web};
use crate::archive::history::{Series, history, what_changed};
use crate::archive::report::report;
use crate::record::estimate::Verdict;
use crate::service::config::Demand;
use crate::store::{Journal, RunId, RunSummary};

const SCRIPT: &str = include_str!("templates/live.js");
const TEMPLATES: [(&str, &str); 7] = [
    ("base.html", include_str!("templates/base.html")),
    ("machines.html", include_str!("templates/machines.html")),
    ("machine.html", include_str!("templates/machine.html")),
    ("live.html", include_str!("templates/live.html")),
    ("runs.html", include_str!("templates/runs.html")),
    ("runs_table.html", include_str!("templates/runs_table.html")),
    ("login.html", include_str!("templates/login.html")),
];
/// Runs on a machine's page.
const NEWEST: usize = 10;
/// What changed is asked for so long.
const DAYS: u32 = 7;

pub fn routes() -> Router<Web> {
    Router::new()
        .route("/", get(machines))
        .route("/machines/{name}", get(machine))
        .route("/machines/{name}/live", get(live))
        .route("/runs", get(runs))
        .route("/runs/{run}", get(run))
        .route("/live.js", get(script))
}

/// Of a machine's page. Names of machines may hold anything.
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

/// The templates, read once.
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

/// One machine is shown at once.
async fn machines(State(web): State<Web>) -> Result<Response, Problem> {
    if let [only] = &*web.machines {
        return Ok(Redirect::to(&address(&only.name)).into_response());
    }
    let machines: Vec<Value> = web.machines.iter().map(standing).collect();
    Ok(render("machines.html", context! { machines })?.into_response())
}

async fn machine(State(web): State<Web>, Path(name): Path<String>) -> Result<Response, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let named = name.clone();
    let (all, runs) = look(&web, move |journal| {
        Ok::<_, Problem>((history(journal, &named)?, newest(journal, &named)?))
    })
    .await??;
    let values = context! {
        machine => standing(machine),
        vouch => machine.demand.iter().map(vouch).collect::<Vec<_>>(),
        trends => all.chunk_by(|one, other| one.method == other.method).map(trends).collect::<Vec<_>>(),
        runs => runs,
    };
    Ok(render("machine.html", values)?.into_response())
}

/// The part that changes, for the script.
async fn live(State(web): State<Web>, Path(name): Path<String>) -> Result<Html<String>, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    render("live.html", context! { machine => standing(machine) })
}

async fn runs(State(web): State<Web>) -> Result<Html<String>, Problem> {
    let mut all = look(&web, Journal::runs).await??;
    all.reverse();
    render("runs.html", context! { runs => all.iter().map(row).collect::<Vec<_>>() })
}

/// The report is a page of its own.
async fn run(State(web): State<Web>, Path(run): Path<i64>) -> Result<Html<String>, Problem> {
    Ok(Html(look(&web, move |journal| report(journal, RunId(run))).await??))
}

fn newest(journal: &Journal, machine: &str) -> Result<Vec<Value>, Problem> {
    let runs = journal.runs()?;
    let of_machine = runs.iter().rev().filter(|run| run.machine == machine);
    Ok(of_machine.take(NEWEST).map(row).collect())
}

fn row(run: &RunSummary) -> Value {
    context! {
        id => run.id.0,
        started => moment(run.started),
        method => run.method.as_str(),
        machine => run.machine.as_str(),
        state => run.state.as_str(),
        has_report => run.state.as_str() == "finished",
    }
}

fn standing(machine: &Shown) -> Value {
    let standing = Standing::of(machine);
    let (class, glance) = glance(&standing);
    let parameters = standing.parameters.iter().map(|p| {
        context! {
            symbol => p.symbol.as_str(),
            value => format!("{:.1}", p.value),
            expanded => format!("{:.1}", p.expanded),
            unit => p.unit.symbol(),
        }
    });
    let cycles = standing.cycles.iter();
    let cycles = cycles.map(|c| context! { number => c.number, method => c.method.as_str() });
    context! {
        name => standing.name.as_str(),
        state => standing.state,
        run => standing.run,
        stage => standing.stage.as_str(),
        step => standing.step.as_str(),
        progress_percent => standing.progress_percent,
        measured => standing.measured,
        refusal => standing.refusal.as_deref(),
        cycles => cycles.collect::<Vec<_>>(),
        class,
        glance,
        address => address(&machine.name),
        parameters => parameters.collect::<Vec<_>>(),
        remaining => minutes(standing.remaining_s),
        now => moment(Timestamp::now()),
    }
}

/// Class and words of what must be seen from afar.
fn glance(standing: &Standing) -> (&'static str, &'static str) {
    match (standing.state, standing.verdict) {
        ("running", _) => ("measuring", "measuring"),
        ("held", _) => ("held", "held: look at the machine"),
        ("failed", _) => ("unknown", "not measured: the last cycle failed"),
        (_, Some(Verdict::Pass)) => ("true", "true"),
        (_, Some(Verdict::Fail)) => ("untrue", "not true"),
        (_, Some(Verdict::Undecided)) => ("unknown", "undecided"),
        (_, Some(Verdict::None)) => ("unknown", "measured, no tolerance stated"),
        (_, None) => ("unknown", "unknown: not measured since the service began"),
    }
}

fn vouch(demand: &Demand) -> Value {
    let (name, words) = match demand {
        Demand::Enable => ("enable", "the machine is free to be moved, what sits in it is whole"),
        Demand::Auto => ("auto", "the control is in its automatic mode"),
        Demand::Door => ("door", "the guards are closed"),
    };
    context! { name, words }
}

fn trends(of_method: &[Series]) -> Value {
    let rows = of_method.iter().filter_map(|series| {
        let newest = series.values.last()?;
        let limits = series.trend.individuals.map(|chart| chart.limits());
        Some(context! {
            symbol => series.symbol.as_str(),
            runs => series.values.len(),
            value => format!("{:.1}", newest.value),
            expanded => format!("{:.1}", newest.expanded),
            unit => series.unit.symbol(),
            limits => limits.map(|[lower, upper]| format!("{lower:.1} to {upper:.1}")),
            out => series.trend.is_out() == Some(true),
        })
    });
    context! {
        method => of_method.first().map(|series| series.method.as_str()),
        sentence => what_changed(of_method, DAYS),
        rows => rows.collect::<Vec<_>>(),
    }
}

/// By the clock on the wall.
fn moment(at: Timestamp) -> String {
    at.to_zoned(TimeZone::system()).strftime("%Y-%m-%d %H:%M:%S").to_string()
}

fn minutes(seconds: f64) -> String {
    let whole = seconds.max(0.0).round() as u64;
    format!("{}:{:02}", whole / 60, whole % 60)
}
