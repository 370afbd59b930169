//! What many tablets ask for at once is made once: each change of the board brings all of them.

use std::time::{Duration, Instant};

use axum::body::Bytes;
use axum::response::Html;
use tokio::sync::Mutex;

use crate::service::http::problem::Problem;

/// Not shown to anybody who asks later: it says as of when it is.
const FRESH: Duration = Duration::from_millis(250);

/// The live part of one machine's page, as it was made last.
#[derive(Default)]
pub struct Shared(Mutex<Option<Made>>);

struct Made {
    at: Instant,
    /// The board's count of changes.
    change: u64,
    text: Bytes,
}

impl Shared {
    /// As the board stands at `change`. Who comes while it is made waits for it.
    pub async fn at(
        &self,
        change: u64,
        make: impl Future<Output = Result<Html<String>, Problem>>,
    ) -> Result<Html<Bytes>, Problem> {
        let mut last = self.0.lock().await;
        let holds = |made: &Made| made.change == change && made.at.elapsed() < FRESH;
        if let Some(made) = last.as_ref().filter(|made| holds(made)) {
            return Ok(Html(made.text.clone()));
        }
        let at = Instant::now();
        let text = Bytes::from(make.await?.0);
        *last = Some(Made { at, change, text: text.clone() });
        Ok(Html(text))
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    /// Of three who ask at once two share, and the one after the change has his own.
    #[tokio::test]
    async fn a_change_is_never_hidden() {
        let (shared, count) = (Shared::default(), Cell::new(0));
        let make = || async {
            count.set(count.get() + 1);
            tokio::task::yield_now().await;
            Ok(Html(count.get().to_string()))
        };
        let [one, other, later] = [7, 7, 8].map(|change| shared.at(change, make()));
        let (one, other, later) = tokio::join!(one, other, later);
        let all = [one, other, later].map(|made| made.ok().map(|Html(text)| text));
        assert_eq!(all, ["1", "1", "2"].map(|text| Some(Bytes::from(text))));
        tokio::time::sleep(FRESH).await;
        let stale = shared.at(8, make()).await.ok().map(|Html(text)| text);
        assert_eq!(stale, Some(Bytes::from("3")));
    }
}
