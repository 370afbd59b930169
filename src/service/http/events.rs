//! Server-sent events: the state of a machine at each change, and at intervals as a keep-alive. A slow client gets
//! the newest state and misses those between; nothing is queued for it.

use std::convert::Infallible;
use std::time::Duration;

use axum::extract::Extension;
use axum::response::sse::Event;
use axum::response::{IntoResponse, Sse};
use tokio::time::{Instant, MissedTickBehavior, interval_at};
use tokio_stream::wrappers::{IntervalStream, WatchStream};
use tokio_stream::{Stream, StreamExt};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::access::Caller;
use super::machine_status::MachineStatus;
use super::{AppState, ServedMachine};

/// Minimum time between two events that report changes.
const MIN_EVENT_INTERVAL: Duration = Duration::from_millis(100);
/// Period of the keep-alive event: the server detects a lost client, the page detects a lost server, and changes that
/// depend on time alone are sent. An SSE comment would not help the page, because a script cannot read it.
const KEEP_ALIVE_PERIOD: Duration = Duration::from_secs(5);

pub fn event_routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(machine_events))
}

/// Events `standing`: the state of a machine at each change, and every 5 s.
#[utoipa::path(get, path = "/api/v1/machines/{name}/events", operation_id = "of_machine", params(("name" = String, Path)), responses((status = OK, body = MachineStatus, content_type = "text/event-stream")))]
async fn machine_events(machine: ServedMachine, Extension(caller): Extension<Caller>) -> impl IntoResponse {
    // The stream ends when the token is revoked.
    let triggers = event_triggers(&machine).take_while(move |()| caller.is_token_valid());
    let events = triggers.map(move |()| Ok::<_, Infallible>(state_event(&machine)));
    // A proxy that buffers events would make the page treat the server as lost.
    ([("x-accel-buffering", "no")], Sse::new(events))
}

/// Triggers of the events: the first at once, then each change and each keep-alive.
fn event_triggers(machine: &ServedMachine) -> impl Stream<Item = ()> + use<> {
    let changes = WatchStream::new(machine.gate.subscribe_changes()).map(|_| ());
    let changes = changes.throttle(MIN_EVENT_INTERVAL);
    let mut alive = interval_at(Instant::now() + KEEP_ALIVE_PERIOD, KEEP_ALIVE_PERIOD);
    alive.set_missed_tick_behavior(MissedTickBehavior::Delay);
    changes.merge(IntervalStream::new(alive).map(|_| ()))
}

/// Event with the current state of the machine; its id is the number of changes of the machine state so far.
fn state_event(machine: &ServedMachine) -> Event {
    let count = *machine.gate.subscribe_changes().borrow();
    let event = Event::default().event("standing").id(count.to_string());
    event.json_data(MachineStatus::from_machine(machine)).unwrap_or_else(|_| Event::default())
}
