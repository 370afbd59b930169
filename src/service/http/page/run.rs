//! Page of one run: its result, its events, its signatures.

use axum::extract::{Path, State};
use axum::response::Html;
use minijinja::{Value, context};

use super::{address, machine, moment};
use crate::archive::report::report;
use crate::archive::story::{how_it_ended, signed, story};
use crate::report::temperature;
use crate::service::http::AppState;
use crate::service::http::journal::read_journal;
use crate::service::http::problem::Problem;
use crate::store::{Journal, RunId, RunState, RunSummary, StoredRun, Wanted};
use ::machine::record::estimate::Estimate;

pub async fn page(
    State(web): State<AppState>,
    Path(run): Path<i64>,
) -> Result<Html<String>, Problem> {
    let tokens = web.access.demanded();
    read_journal(&web, move |journal| {
        let stored = journal.load(RunId(run))?;
        let before = before(journal, &stored.summary)?;
        super::whole("run.html", tokens, values(&stored, before))
    })
    .await?
}

/// The report is a separate page.
pub async fn whole(
    State(web): State<AppState>,
    Path(run): Path<i64>,
) -> Result<Html<String>, Problem> {
    Ok(Html(read_journal(&web, move |journal| report(journal, RunId(run))).await??))
}

/// The previous finished run of the same machine and method, for a comparison.
fn before(journal: &Journal, this: &RunSummary) -> Result<Option<i64>, Problem> {
    let wanted = Wanted {
        before: Some(this.id),
        machine: Some(&this.machine),
        method: Some(&this.method),
        state: Some(RunState::Finished),
        ..Wanted::default()
    };
    Ok(journal.some_runs(wanted, 1)?.first().map(|run| run.id.0))
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
        warmth => temperature::rows(&stored.readings),
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
            judged => p.judged.map(|judged| context! {
                limit => format!("{:.1}", judged.limit),
                verdict => judged.verdict.to_string(),
            }),
        }
    });
    let is_judged = estimate.parameters.iter().any(|p| p.judged.is_some());
    context! { class, glance, is_judged, parameters => rows.collect::<Vec<_>>() }
}
