//! Server-sent events: how a machine stands, whenever that changes. Who listens slowly gets the newest and
//! misses what was between: nothing is kept for him.

use std::convert::Infallible;
use std::time::Duration;

use axum::extract::{Extension, Path, State};
use axum::response::Sse;
use axum::response::sse::{Event, KeepAlive};
use tokio_stream::wrappers::WatchStream;
use tokio_stream::{Stream, StreamExt};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::access::Caller;
use super::problem::Problem;
use super::standing::Standing;
use super::{Shown, Web};

/// At most so often.
const EVERY: Duration = Duration::from_millis(100);
/// A listener that has gone is noticed, and a page knows that the server lives.
const ALIVE: Duration = Duration::from_secs(5);

pub fn routes() -> OpenApiRouter<Web> {
    OpenApiRouter::new().routes(routes!(of_machine))
}

/// Events `standing`: how a machine stands, whenever that changes.
#[utoipa::path(get, path = "/api/v1/machines/{name}/events", params(("name" = String, Path)), responses((status = OK, body = Standing, content_type = "text/event-stream")))]
async fn of_machine(
    State(web): State<Web>,
    Path(name): Path<String>,
    Extension(caller): Extension<Caller>,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?.clone();
    let changes = WatchStream::new(machine.desk.changes()).throttle(EVERY);
    // A token that is revoked hears no more.
    let changes = changes.take_while(move |_| caller.stands());
    let events = changes.map(move |count| Ok(event(count, &machine)));
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(ALIVE)))
}

fn event(count: u64, machine: &Shown) -> Event {
    let event = Event::default().event("standing").id(count.to_string());
    event.json_data(Standing::of(machine)).unwrap_or_else(|_| Event::default())
}
