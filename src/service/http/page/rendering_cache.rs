//! Cache of the live part: each change of the machine state makes all tablets request it at once, and it is rendered
//! once for all of them.

use std::time::{Duration, Instant};

use axum::body::Bytes;
use axum::response::Html;
use tokio::sync::Mutex;

use crate::service::http::problem::Problem;

/// Maximum age of the cached text, because the text contains the time of its rendering.
const MAX_RENDERING_AGE: Duration = Duration::from_millis(250);

/// Last rendering of the live part of one machine's page.
#[derive(Default)]
pub struct RenderingCache(Mutex<Option<Rendering>>);

struct Rendering {
    rendered_at: Instant,
    /// Number of changes of the machine state at the rendering.
    change_count: u64,
    html: Bytes,
}

impl RenderingCache {
    /// Returns the text for the machine state after `change_count` changes, at most [`MAX_RENDERING_AGE`] old.
    /// Concurrent callers share one rendering.
    pub async fn get_or_render(
        &self,
        change_count: u64,
        render: impl Future<Output = Result<Html<String>, Problem>>,
    ) -> Result<Html<Bytes>, Problem> {
        let mut last = self.0.lock().await;
        let is_current =
            |made: &Rendering| made.change_count == change_count && made.rendered_at.elapsed() < MAX_RENDERING_AGE;
        if let Some(made) = last.as_ref().filter(|made| is_current(made)) {
            return Ok(Html(made.html.clone()));
        }
        let rendered_at = Instant::now();
        let text = Bytes::from(render.await?.0);
        *last = Some(Rendering { rendered_at, change_count, html: text.clone() });
        Ok(Html(text))
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    /// Of three concurrent requests, two share one rendering; the one after the change gets its own.
    #[tokio::test]
    async fn rendering_is_shared_until_the_state_changes_or_it_is_too_old() {
        let (shared, count) = (RenderingCache::default(), Cell::new(0));
        let make = || async {
            count.set(count.get() + 1);
            tokio::task::yield_now().await;
            Ok(Html(count.get().to_string()))
        };
        let [one, other, later] = [7, 7, 8].map(|change| shared.get_or_render(change, make()));
        let (one, other, later) = tokio::join!(one, other, later);
        let all = [one, other, later].map(|made| made.ok().map(|Html(text)| text));
        assert_eq!(all, ["1", "1", "2"].map(|text| Some(Bytes::from(text))));
        tokio::time::sleep(MAX_RENDERING_AGE).await;
        let stale = shared.get_or_render(8, make()).await.ok().map(|Html(text)| text);
        assert_eq!(stale, Some(Bytes::from("3")));
    }
}
