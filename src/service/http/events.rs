//! Server-sent events: how a machine stands, whenever that changes, and now and then as a sign of life. Who
//! listens slowly gets the newest and misses what was between: nothing is kept for him.

use std::convert::Infallible;
use std::time::Duration;

use axum::extract::{Extension, Path, State};
use axum::response::sse::Event;
use axum::response::{IntoResponse, Sse};
use tokio::time::{Instant, MissedTickBehavior, interval_at};
use tokio_stream::wrappers::{IntervalStream, WatchStream};
use tokio_stream::{Stream, StreamExt};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::access::Caller;
use super::problem::Problem;
use super::standing::Standing;
use super::{Shown, Web};

/// At most so often.
const EVERY: Duration = Duration::from_millis(100);
/// And at least so often: a listener that has gone is noticed, a page knows that the server lives, and what
/// changes by time alone is told. A comment would do for the first, but no script sees one.
const ALIVE: Duration = Duration::from_secs(5);

pub fn routes() -> OpenApiRouter<Web> {
    OpenApiRouter::new().routes(routes!(of_machine))
}

/// Events `standing`: how a machine stands, whenever that changes, and every 5 s.
#[utoipa::path(get, path = "/api/v1/machines/{name}/events", params(("name" = String, Path)), responses((status = OK, body = Standing, content_type = "text/event-stream")))]
async fn of_machine(
    State(web): State<Web>,
    Path(name): Path<String>,
    Extension(caller): Extension<Caller>,
) -> Result<impl IntoResponse, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?.clone();
    // A token that is revoked hears no more.
    let told = looks(&machine).take_while(move |()| caller.stands());
    let events = told.map(move |()| Ok::<_, Infallible>(event(&machine)));
    // A proxy that keeps them back until there are many would make the page believe that we are away.
    Ok(([("x-accel-buffering", "no")], Sse::new(events)))
}

/// When there is something to tell; at first at once.
fn looks(machine: &Shown) -> impl Stream<Item = ()> + use<> {
    let board = WatchStream::new(machine.desk.changes());
    // The first of them is the board's.
    let results = WatchStream::from_changes(machine.last.changes());
    let changes = board.merge(results).map(|_| ()).throttle(EVERY);
    let mut alive = interval_at(Instant::now() + ALIVE, ALIVE);
    alive.set_missed_tick_behavior(MissedTickBehavior::Delay);
    changes.merge(IntervalStream::new(alive).map(|_| ()))
}

fn event(machine: &Shown) -> Event {
    let count = *machine.desk.changes().borrow();
    let event = Event::default().event("standing").id(count.to_string());
    event.json_data(Standing::of(machine)).unwrap_or_else(|_| Event::default())
}
