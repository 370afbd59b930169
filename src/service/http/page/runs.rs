//! Paged list of the runs.

use axum::extract::{Query, State};
use axum::response::Html;
use minijinja::context;

use super::{row, whole};
use crate::service::http::AppState;
use crate::service::http::api::RunsAsked;
use crate::service::http::journal::read_journal;
use crate::service::http::problem::Problem;

pub async fn page(
    State(web): State<AppState>,
    Query(asked): Query<RunsAsked>,
) -> Result<Html<String>, Problem> {
    let tokens = web.access.demanded();
    read_journal(&web, move |journal| {
        let (wanted, most) = (asked.wanted(), asked.most());
        // One more run than shown is read, to detect whether more runs exist.
        let mut runs = journal.some_runs(wanted, most + 1)?;
        let onward = wanted.after.is_some() && wanted.before.is_none();
        let more = runs.len() > most;
        match (more, onward) {
            (true, true) => drop(runs.remove(0)),
            (true, false) => drop(runs.pop()),
            (false, _) => {}
        }
        let [newest, oldest] = [runs.first(), runs.last()].map(|run| run.map(|run| run.id.0));
        let newer = newest.filter(|_| if onward { more } else { wanted.before.is_some() });
        let older = oldest.filter(|_| onward || more);
        let runs = runs.iter().map(row).collect::<Vec<_>>();
        whole("runs.html", tokens, context! { runs, newer, older })
    })
    .await?
}
