//! Page of one run: its result, its events, its signatures.

use axum::extract::{Path, State};
use axum::response::Html;
use minijinja::{Value, context};

use super::{local_time, machine, machine_page_path};
use crate::archive::report::render_report;
use crate::archive::run_story::{describe_end, describe_signatures, run_story};
use crate::report::temperature;
use crate::service::http::AppState;
use crate::service::http::journal::read_journal;
use crate::service::http::problem::Problem;
use crate::store::{Journal, RunFilter, RunId, RunState, RunSummary, StoredRun};
use ::machine::record::estimate::Estimate;

pub async fn run_page(State(app): State<AppState>, Path(run): Path<i64>) -> Result<Html<String>, Problem> {
    let tokens = app.access.requires_tokens();
    read_journal(&app, move |journal| {
        let stored = journal.load_run(RunId(run))?;
        let before = previous_run(journal, &stored.summary)?;
        super::render_page("run.html", tokens, run_values(&stored, before))
    })
    .await?
}

/// The report is a separate page.
pub async fn report_page(State(app): State<AppState>, Path(run): Path<i64>) -> Result<Html<String>, Problem> {
    Ok(Html(read_journal(&app, move |journal| render_report(journal, RunId(run))).await??))
}

/// The previous finished run of the same machine and method, for a comparison.
fn previous_run(journal: &Journal, this: &RunSummary) -> Result<Option<i64>, Problem> {
    let wanted = RunFilter {
        older_than: Some(this.id),
        machine: Some(&this.machine),
        method: Some(&this.method),
        state: Some(RunState::Finished),
        ..RunFilter::default()
    };
    Ok(journal.list_runs(wanted, 1)?.first().map(|run| run.id.0))
}

fn run_values(stored: &StoredRun, before: Option<i64>) -> Value {
    let summary = &stored.summary;
    let last = stored.estimates.last();
    let unfinished = !matches!(summary.state, RunState::Finished | RunState::Running);
    context! {
        run => super::run_row(summary),
        machine => machine_page_path(&summary.machine),
        ended => unfinished.then(|| describe_end(stored)),
        readings => stored.readings.len(),
        warmth => temperature::temperature_rows(&stored.readings),
        story => run_story(stored),
        signed => describe_signatures(stored),
        before,
        estimate => last.map(|last| context! {
            made => local_time(last.created),
            sha256 => last.sha256.as_str(),
            ..estimate_values(&last.estimate)
        }),
    }
}

fn estimate_values(estimate: &Estimate) -> Value {
    let (class, glance) = machine::verdict_banner(estimate.verdict);
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
