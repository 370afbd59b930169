//! Journal queries for HTTP responses.

use std::sync::Arc;

use axum::http::StatusCode;

use super::AppState;
use super::problem::Problem;
use crate::store::Journal;

/// Reads the journal outside the thread of the HTTP server, because the disk may be slow.
pub async fn read_journal<T: Send + 'static>(
    app: &AppState,
    read: impl FnOnce(&Journal) -> T + Send + 'static,
) -> Result<T, Problem> {
    let journal = Arc::clone(&app.journal);
    // If the client disconnects while it waits for a reader, nothing is read.
    let permit = Arc::clone(&app.reader_permits).acquire_owned().await;
    let read = move || {
        let read = read(&journal);
        drop(permit);
        read
    };
    tokio::task::spawn_blocking(read).await.map_err(|_| {
        let status = StatusCode::INTERNAL_SERVER_ERROR;
        Problem::new(status, "no-answer", "the journal query ended without a result", "repeat the request")
    })
}
