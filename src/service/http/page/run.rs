//! The page of one run: what it said, what it went through, who answers for it.

use axum::extract::{Path, State};
use axum::response::Html;
use minijinja::{Value, context};

use super::{address, machine, moment, render};
use crate::archive::report::report;
use crate::archive::story::{how_it_ended, signed, story};
use crate::record::estimate::Estimate;
use crate::service::http::Web;
use crate::service::http::api::look;
use crate::service::http::problem::Problem;
use crate::store::{Journal, RunId, RunState, RunSummary, StoredRun};

pub async fn page(State(web): State<Web>, Path(run): Path<i64>) -> Result<Html<String>, Problem> {
    let (stored, before) = look(&web, move |journal| {
        let stored = journal.load(RunId(run))?;
        let before = before(journal, &stored.summary)?;
        Ok::<_, Problem>((stored, before))
    })
    .await??;
    render("run.html", values(&stored, before))
}

/// The report is a page of its own.
pub async fn whole(State(web): State<Web>, Path(run): Path<i64>) -> Result<Html<String>, Problem> {
    Ok(Html(look(&web, move |journal| report(journal, RunId(run))).await??))
}

/// The finished run of the same kind before this one, to compare it with.
fn before(journal: &Journal, this: &RunSummary) -> Result<Option<i64>, Problem> {
    let alike = |run: &&RunSummary| {
        run.id < this.id
            && (&run.machine, &run.method, run.state)
                == (&this.machine, &this.method, RunState::Finished)
    };
    Ok(journal.runs()?.iter().rev().find(alike).map(|run| run.id.0))
}

fn values(stored: &StoredRun, before: Option<i64>) -> Value {
    let summary = &stored.summary;
    let last = stored.estimates.last();
    let unfinished = !matches!(summary.state, RunState::Finished | RunState::Running);
    context! {
        run => super::row(summary),
        machine => address(&summary.machine),
        ended => unfinished.then(|| how_it_ended(stored)),
        readings => stored.readings.len(),
        story => story(stored),
        signed => signed(stored),
        before,
        estimate => last.map(|last| context! {
            made => moment(last.made),
            sha256 => last.sha256.as_str(),
            ..result(&last.estimate)
        }),
    }
}

fn result(estimate: &Estimate) -> Value {
    let (class, glance) = machine::of_verdict(estimate.verdict);
    let rows = estimate.parameters.iter().map(|p| {
        context! {
            symbol => p.symbol.as_str(),
            value => format!("{:.1}", p.value),
            expanded => format!("{:.1}", p.expanded),
            unit => p.unit.symbol(),
            identifiable => p.identifiable,
        }
    });
    context! { class, glance, parameters => rows.collect::<Vec<_>>() }
}
