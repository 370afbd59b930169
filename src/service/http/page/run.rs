//! Page of one run: its result, figures, events and signatures.

use std::sync::Arc;

use axum::extract::{Path, State};
use axum::response::Html;
use minijinja::value::Serde;
use minijinja::{Value, context};

use super::{compensation, machine, machine_page_path, row_of_run};
use crate::archive::compare::earlier_finished_runs;
use crate::archive::report::render_report;
use crate::archive::run_story::{
    describe_events_with_times, describe_record_warnings, describe_run_end, describe_signatures, in_local_time,
};
use crate::report::residuals::{residual_figure_values, residual_figures};
use crate::report::result_row::{ResultRow, RunContext, result_rows, rows_not_passed};
use crate::report::time::format_local_time;
use crate::report::{figure_values, has_location_errors, temperature};
use crate::service::http::AppState;
use crate::service::http::problem::Problem;
use crate::setup::CompensationConfig;
use crate::store::{RunId, RunState, RunSummary, StoredRun};
use ::machine::record::estimate::Estimate;
use methods::symbol_names::ResultGroup;

/// Maximum number of earlier runs that are offered for a comparison.
const MAX_COMPARABLE_RUNS: usize = 50;

pub async fn run_page(State(app): State<AppState>, Path(run): Path<i64>) -> Result<Html<String>, Problem> {
    let (tokens, machines) = (app.access.requires_tokens, Arc::clone(&app.machines));
    app.read_journal(move |journal| {
        let stored = journal.load_run(RunId(run))?;
        let earlier = earlier_finished_runs(journal, &stored.summary, MAX_COMPARABLE_RUNS)?;
        let machine = machines.iter().find(|machine| machine.name == stored.summary.machine);
        let targets = machine.map(|machine| machine.machine_file.compensation.iter().map(CompensationConfig::kind));
        let targets: Vec<&str> = targets.into_iter().flatten().collect();
        let file = machine.map(|machine| &machine.machine_file);
        let verifiable_targets = file.map(|file| compensation::verifiable_targets(journal, file, RunId(run)));
        let verifiable_targets = verifiable_targets.transpose()?.unwrap_or_default();
        let values = context! { targets, verifiable_targets, ..values_of_run(&stored, &earlier) };
        super::render_page("run.html", tokens, values)
    })
    .await?
}

/// Report of a run, as a page of its own.
pub async fn report_page(State(app): State<AppState>, Path(run): Path<i64>) -> Result<Html<String>, Problem> {
    Ok(Html(app.read_journal(move |journal| render_report(journal, RunId(run))).await??))
}

fn values_of_run(stored: &StoredRun, earlier: &[RunSummary]) -> Value {
    let summary = &stored.summary;
    let last = stored.estimates.last();
    let unfinished = !matches!(summary.state, RunState::Finished | RunState::Running);
    context! {
        run => row_of_run(summary),
        machine => machine_page_path(&summary.machine),
        ended => unfinished.then(|| describe_run_end(stored)),
        readings => stored.readings.len(),
        warmth => temperature::temperature_rows(&stored.readings),
        story => in_local_time(describe_events_with_times(stored)),
        signed => describe_signatures(stored),
        comparable => earlier.iter().map(row_of_run).collect::<Vec<_>>(),
        files => download_values(summary.id),
        estimate => last.map(|last| context! {
            made => format_local_time(last.created),
            sha256 => last.sha256.as_str(),
            record_warnings => describe_record_warnings(stored),
            figures => run_figure_values(stored, &last.estimate),
            ..estimate_values(&last.estimate)
        }),
    }
}

/// Files of a run with an estimate.
fn download_values(run: RunId) -> Vec<Value> {
    let path = |file: &str| format!("/api/v1/runs/{run}/{file}");
    [("results (CSV)", "results.csv"), ("estimate (JSON)", "estimate.json"), ("readings (CSV)", "readings.csv")]
        .map(|(name, file)| context! { name, path => path(file) })
        .to_vec()
}

fn run_figure_values(stored: &StoredRun, estimate: &Estimate) -> Vec<Value> {
    let residuals = residual_figures(&stored.readings, estimate);
    [figure_values(estimate), residual_figure_values(&residuals)].concat()
}

fn estimate_values(estimate: &Estimate) -> Value {
    let (class, glance) = machine::verdict_class_and_text(estimate.verdict);
    let rows = result_rows(RunContext::from_estimate(estimate), &estimate.parameters);
    let is_main = |row: &&ResultRow| row.group == ResultGroup::Main || row.verdict.is_some();
    let (main, details): (Vec<&ResultRow>, Vec<&ResultRow>) = rows.iter().partition(is_main);
    context! {
        class,
        glance,
        is_judged => rows.iter().any(|row| row.verdict.is_some()),
        main => Serde(&main),
        details => Serde(&details),
        not_passed => Serde(&rows_not_passed(&rows)),
        has_location_errors => has_location_errors(estimate),
        warnings => estimate.warnings.clone(),
    }
}
