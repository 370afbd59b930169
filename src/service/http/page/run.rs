//! Paged list of the runs, and the page of one run: its result, its events, its signatures.

use axum::extract::{Path, Query, State};
use axum::response::Html;
use minijinja::{Value, context};

use super::{format_local_time, machine, machine_page_path, parameter_row};
use crate::archive::report::render_report;
use crate::archive::run_story::{describe_events_with_times, describe_run_end, describe_signatures};
use crate::report::temperature;
use crate::service::http::AppState;
use crate::service::http::api::RunListQuery;
use crate::service::http::problem::Problem;
use crate::store::{Journal, RunFilter, RunId, RunState, RunSummary, StoredRun};
use ::machine::record::estimate::Estimate;

/// Paged list of the runs.
pub async fn runs_page(
    State(app): State<AppState>,
    Query(range): Query<RunListQuery>,
) -> Result<Html<String>, Problem> {
    let tokens = app.access.requires_tokens;
    app.read_journal(move |journal| {
        let (filter, limit) = (range.filter(), range.item_limit());
        // One more run than shown is read, to detect whether more runs exist.
        let mut runs = journal.list_runs(filter, limit + 1)?;
        let onward = filter.newer_than.is_some() && filter.older_than.is_none();
        let more = runs.len() > limit;
        match (more, onward) {
            (true, true) => drop(runs.remove(0)),
            (true, false) => drop(runs.pop()),
            (false, _) => {}
        }
        let [newest, oldest] = [runs.first(), runs.last()].map(|run| run.map(|run| run.id.0));
        let newer = newest.filter(|_| if onward { more } else { filter.older_than.is_some() });
        let older = oldest.filter(|_| onward || more);
        let runs = runs.iter().map(super::row_of_run).collect::<Vec<_>>();
        super::render_page("runs.html", tokens, context! { runs, newer, older })
    })
    .await?
}

pub async fn run_page(State(app): State<AppState>, Path(run): Path<i64>) -> Result<Html<String>, Problem> {
    let tokens = app.access.requires_tokens;
    app.read_journal(move |journal| {
        let stored = journal.load_run(RunId(run))?;
        let before = previous_finished_run(journal, &stored.summary)?;
        super::render_page("run.html", tokens, values_of_run(&stored, before))
    })
    .await?
}

/// Report of a run, as a page of its own.
pub async fn report_page(State(app): State<AppState>, Path(run): Path<i64>) -> Result<Html<String>, Problem> {
    Ok(Html(app.read_journal(move |journal| render_report(journal, RunId(run))).await??))
}

/// The previous finished run of the same machine and method, for a comparison.
fn previous_finished_run(journal: &Journal, run: &RunSummary) -> Result<Option<i64>, Problem> {
    let wanted = RunFilter {
        older_than: Some(run.id),
        machine: Some(&run.machine),
        method: Some(&run.method),
        state: Some(RunState::Finished),
        ..RunFilter::default()
    };
    Ok(journal.list_runs(wanted, 1)?.first().map(|run| run.id.0))
}

fn values_of_run(stored: &StoredRun, previous_run: Option<i64>) -> Value {
    let summary = &stored.summary;
    let last = stored.estimates.last();
    let unfinished = !matches!(summary.state, RunState::Finished | RunState::Running);
    context! {
        run => super::row_of_run(summary),
        machine => machine_page_path(&summary.machine),
        ended => unfinished.then(|| describe_run_end(stored)),
        readings => stored.readings.len(),
        warmth => temperature::temperature_rows(&stored.readings),
        story => describe_events_with_times(stored),
        signed => describe_signatures(stored),
        before => previous_run,
        estimate => last.map(|last| context! {
            made => format_local_time(last.created),
            sha256 => last.sha256.as_str(),
            ..estimate_values(&last.estimate)
        }),
    }
}

fn estimate_values(estimate: &Estimate) -> Value {
    let (class, glance) = machine::verdict_class_and_text(estimate.verdict);
    let rows = estimate.parameters.iter().map(parameter_row);
    let has_limits = estimate.parameters.iter().any(|p| p.judged.is_some());
    context! { class, glance, is_judged => has_limits, parameters => rows.collect::<Vec<_>>() }
}
