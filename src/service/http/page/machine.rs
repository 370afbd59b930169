//! The page of one machine: how it stands, what can be done, how its values went.

use axum::body::Bytes;
use axum::extract::{Path, State};
use axum::response::Html;
use jiff::Timestamp;
use minijinja::{Value, context};

use super::{address, moment, render, row, schedule, trends, views};
use crate::archive::history::history;
use crate::record::estimate::Verdict;
use crate::run::{can_resume, question};
use crate::service::board::Failure;
use crate::service::config::Demand;
use crate::service::http::api::look;
use crate::service::http::problem::Problem;
use crate::service::http::standing::Standing;
use crate::service::http::{Shown, Web};
use crate::service::rota::agenda;
use crate::store::{Journal, RunId, StoredRun};

/// Runs on a machine's page.
const NEWEST: usize = 10;

pub async fn page(
    State(web): State<Web>,
    Path(name): Path<String>,
) -> Result<Html<String>, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?;
    let (run, desk) = (machine.desk.board().run, machine.desk.clone());
    let limits = machine.tolerance.clone();
    let (all, (runs, waits), drawn, agenda) = look(&web, move |journal| {
        let drawn = views::of_run(journal, RunId(run.into()))?;
        let agenda = agenda(journal, &desk, &name)?;
        let all = history(journal, &name, &limits)?;
        Ok::<_, Problem>((all, newest(journal, &name)?, drawn, agenda))
    })
    .await??;
    let values = context! {
        machine => standing(machine),
        views => drawn,
        waits => waits,
        vouch => machine.demand.iter().map(vouch).collect::<Vec<_>>(),
        trends => all.chunk_by(|one, other| one.method == other.method).map(trends::of_method).collect::<Vec<_>>(),
        runs => runs,
        schedule => schedule::panel(&agenda),
    };
    render("machine.html", values)
}

/// The part that changes, for the script.
pub async fn live(
    State(web): State<Web>,
    Path(name): Path<String>,
) -> Result<Html<Bytes>, Problem> {
    let (machine, shared) =
        web.machine(&name).zip(web.live.get(&name)).ok_or_else(|| Problem::not_found(&name))?;
    // Looked at first: what changes while it is made is made again.
    let change = *machine.desk.changes().borrow();
    let make = async {
        let run = machine.desk.board().run;
        let views = look(&web, move |journal| views::of_run(journal, RunId(run.into()))).await??;
        render("live.html", context! { machine => standing(machine), views })
    };
    shared.at(change, make).await
}

/// The newest runs, and the last one if it waits for a person, with what is asked before it goes on.
fn newest(journal: &Journal, machine: &str) -> Result<(Vec<Value>, Option<Value>), Problem> {
    let runs = journal.runs()?;
    let of_machine = runs.iter().rev().filter(|run| run.machine == machine);
    let last = of_machine.clone().next().filter(|run| run.state.is_resumable());
    let waits = last.map(|last| journal.load(last.id)).transpose()?;
    Ok((of_machine.take(NEWEST).map(row).collect(), waits.as_ref().map(waiting)))
}

fn waiting(stored: &StoredRun) -> Value {
    let asked = question(stored);
    context! {
        run => asked.run.0,
        ended => asked.ended,
        position_lost => asked.position_lost,
        can_resume => can_resume(&stored.plan, &stored.readings),
    }
}

pub fn standing(machine: &Shown) -> Value {
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
        failure => standing.failure.as_ref().map(|Failure { what, remedy }| context! { what, remedy }),
        asked => standing.asked.as_ref().map(|asked| context! {
            step => asked.step,
            repeat => asked.repeat,
            text => asked.text.as_str(),
        }),
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
        ("held", _) if standing.elsewhere => ("held", "held: another program has the machine"),
        ("running", _) if standing.asked.is_some() => ("held", "waits: a person is asked"),
        ("running", _) => ("measuring", "measuring"),
        ("held", _) => ("held", "held: look at the machine"),
        ("failed", _) => ("unknown", "not measured: the last cycle failed"),
        (_, Some(verdict)) => of_verdict(verdict),
        (_, None) => ("unknown", "unknown: not measured since the service began"),
    }
}

pub fn of_verdict(verdict: Verdict) -> (&'static str, &'static str) {
    match verdict {
        Verdict::Pass => ("true", "true"),
        Verdict::Fail => ("untrue", "not true"),
        Verdict::Undecided => ("unknown", "undecided"),
        Verdict::None => ("unknown", "measured, no tolerance stated"),
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

fn minutes(seconds: f64) -> String {
    let whole = seconds.max(0.0).round() as u64;
    format!("{}:{:02}", whole / 60, whole % 60)
}
