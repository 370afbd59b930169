//! Paged list of the runs.

use axum::extract::{Query, State};
use axum::response::Html;
use minijinja::context;

use super::{render_page, run_row};
use crate::service::http::AppState;
use crate::service::http::api::RunListQuery;
use crate::service::http::journal::read_journal;
use crate::service::http::problem::Problem;

pub async fn runs_page(
    State(app): State<AppState>,
    Query(range): Query<RunListQuery>,
) -> Result<Html<String>, Problem> {
    let tokens = app.access.requires_tokens();
    read_journal(&app, move |journal| {
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
        let runs = runs.iter().map(run_row).collect::<Vec<_>>();
        render_page("runs.html", tokens, context! { runs, newer, older })
    })
    .await?
}
