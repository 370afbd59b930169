//! Page of the audit log.

use axum::extract::{Query, State};
use axum::response::Html;
use minijinja::{Value, context};
use serde::Deserialize;

use super::render_page;
use crate::report::time::format_local_time;
use crate::service::http::AppState;
use crate::service::http::problem::Problem;
use crate::store::StoredAuditEntry;

/// Number of entries on a page.
const ENTRIES_PER_PAGE: usize = 50;

/// Range of entries.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AuditPageQuery {
    /// Only entries older than the one with this number; `None`: the newest entries.
    before: Option<i64>,
}

pub async fn audit_page(
    State(app): State<AppState>,
    Query(AuditPageQuery { before }): Query<AuditPageQuery>,
) -> Result<Html<String>, Problem> {
    let tokens = app.access.requires_tokens;
    app.read_journal(move |journal| {
        let mut entries = journal.audit_entries(before, ENTRIES_PER_PAGE + 1)?;
        let has_older = entries.len() > ENTRIES_PER_PAGE;
        entries.truncate(ENTRIES_PER_PAGE);
        let older = entries.last().filter(|_| has_older).map(|entry| entry.seq);
        render_page(
            "audit.html",
            tokens,
            context! { entries => entries.iter().map(entry_values).collect::<Vec<_>>(), older },
        )
    })
    .await?
}

fn entry_values(stored: &StoredAuditEntry) -> Value {
    let entry = &stored.entry;
    context! {
        at => format_local_time(stored.at),
        who => entry.who.as_str(),
        what => entry.what.as_str(),
        why => entry.why.as_str(),
        machine => entry.machine.as_str(),
        run => entry.run,
        outcome => entry.outcome.as_str(),
    }
}
