//! Server-sent events: the state of a machine at each change, and at intervals as a keep-alive. A slow client gets
//! the newest state and misses those between; nothing is queued for it.

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
use super::status::MachineStatus;
use super::{AppState, ServedMachine};

/// Minimum time between two events that report changes.
const EVERY: Duration = Duration::from_millis(100);
/// Period of the keep-alive event. By it the server detects a lost client, the page detects a lost server, and
/// changes that depend on time alone are sent. An SSE comment would only serve the first: a script cannot see it.
const ALIVE: Duration = Duration::from_secs(5);

pub fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(of_machine))
}

/// Events `standing`: the state of a machine at each change, and every 5 s.
#[utoipa::path(get, path = "/api/v1/machines/{name}/events", params(("name" = String, Path)), responses((status = OK, body = MachineStatus, content_type = "text/event-stream")))]
async fn of_machine(
    State(web): State<AppState>,
    Path(name): Path<String>,
    Extension(caller): Extension<Caller>,
) -> Result<impl IntoResponse, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?.clone();
    // The stream ends when the token is revoked.
    let told = looks(&machine).take_while(move |()| caller.stands());
    let events = told.map(move |()| Ok::<_, Infallible>(event(&machine)));
    // A proxy that buffers events would make the page treat the server as lost.
    Ok(([("x-accel-buffering", "no")], Sse::new(events)))
}

/// Triggers of the events: the first at once, then each change and each keep-alive.
fn looks(machine: &ServedMachine) -> impl Stream<Item = ()> + use<> {
    let changes = WatchStream::new(machine.gate.changes()).map(|_| ()).throttle(EVERY);
    let mut alive = interval_at(Instant::now() + ALIVE, ALIVE);
    alive.set_missed_tick_behavior(MissedTickBehavior::Delay);
    changes.merge(IntervalStream::new(alive).map(|_| ()))
}

fn event(machine: &ServedMachine) -> Event {
    let count = *machine.gate.changes().borrow();
    let event = Event::default().event("standing").id(count.to_string());
    event.json_data(MachineStatus::of(machine)).unwrap_or_else(|_| Event::default())
}
