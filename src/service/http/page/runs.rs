//! Paged list of the runs with its filters.

use std::sync::Arc;

use axum::extract::{Query, State};
use axum::response::Html;
use minijinja::{Value, context};

use super::{render_page, row_of_run_on};
use crate::service::http::AppState;
use crate::service::http::problem::Problem;
use crate::service::http::run_list_query::RunListQuery;
use crate::store::RunSummary;
use ::machine::record::estimate::Verdict;

pub async fn runs_page(
    State(app): State<AppState>,
    Query(query): Query<RunListQuery>,
) -> Result<Html<String>, Problem> {
    let tokens = app.access.requires_tokens;
    let filters = filter_values(&app, &query);
    let machines = Arc::clone(&app.machines);
    app.read_journal(move |journal| {
        let (filter, limit) = (query.filter(), query.item_limit());
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
        let row = |run: &RunSummary| row_of_run_on(machines.iter().find(|machine| machine.name == run.machine), run);
        let runs = runs.iter().map(row).collect::<Vec<_>>();
        render_page("runs.html", tokens, context! { runs, newer, older, filters, filter_query => query.filter_query() })
    })
    .await?
}

/// The filters of the list, each with its values and the chosen one.
fn filter_values(app: &AppState, query: &RunListQuery) -> Vec<Value> {
    let machines: Vec<String> = app.machines.iter().map(|machine| machine.name.clone()).collect();
    let methods: Vec<String> = methods::method_names().into_iter().map(str::to_owned).collect();
    let verdicts: Vec<String> = Verdict::ALL.map(|verdict| verdict.to_string()).to_vec();
    // A machine that is no longer served may be chosen in the address.
    let filter = |name: &str, mut values: Vec<String>, chosen: Option<String>| {
        values.extend(chosen.clone().filter(|chosen| !values.contains(chosen)));
        context! { name, values, chosen }
    };
    vec![
        filter("machine", machines, query.machine.clone()),
        filter("method", methods, query.method.clone()),
        filter("verdict", verdicts, query.verdict.map(|verdict| verdict.to_string())),
    ]
}
