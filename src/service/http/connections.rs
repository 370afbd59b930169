//! Connections of the HTTP server. Their number is limited, and every wait for a request or a response has a time
//! limit. When the maximum number is reached, a new connection replaces the oldest connection of the client with the
//! most connections; connections without a request in progress are replaced first. A new connection has one second to
//! send its request before it can be replaced, so that a hold arrives however many clients are connected. No
//! connection is refused, because it might carry a hold.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::convert::Infallible;
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::ConnectInfo;
use axum::http::header::{CONTENT_TYPE, HeaderValue};
use axum::response::{IntoResponse, Response};
use http_body::{Frame, SizeHint};
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service as _, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use rustix::net::sockopt::set_tcp_user_timeout;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::AbortHandle;
use tokio::time::{MissedTickBehavior, interval, sleep};

use super::access::ClientIdentity;
use super::problem::Problem;
use crate::service::lock;

/// Maximum number of connections, without the fresh ones, which [`MAX_FRESH_CONNECTIONS`] limits.
const MAX_NON_FRESH_CONNECTIONS: usize = 256;
/// Time for which a new connection without a request counts as fresh; fresh connections use few resources.
const FRESH_CONNECTION_DURATION: Duration = Duration::from_secs(1);
/// Maximum number of fresh connections.
const MAX_FRESH_CONNECTIONS: usize = 512;
/// Maximum number of connections that receive events.
const MAX_EVENT_STREAMS: usize = 64;
/// Maximum time to receive the head of a request, from the end of the previous request.
const REQUEST_HEAD_TIMEOUT: Duration = Duration::from_secs(15);
/// Maximum time from the head of a request until the client has received the response; after that, the connection is
/// closed. Events continue for as long as the client receives them.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(15);
/// Maximum size of the head of a request, bytes.
const MAX_REQUEST_HEAD_BYTES: usize = 16 * 1024;
/// Maximum number of header fields of a request.
const MAX_HEADER_FIELDS: usize = 64;
/// Size above which a response is large, bytes.
const LARGE_RESPONSE_THRESHOLD_BYTES: u64 = 64 * 1024;
/// Maximum number of large responses in progress; a further one is replaced by an error response (503).
const MAX_CONCURRENT_LARGE_RESPONSES: usize = 16;

/// State of a connection, in the order in which connections are closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum ConnectionState {
    /// No request has begun yet.
    New,
    /// A response is complete, and no further request has begun.
    Idle,
    /// A request is being executed, or its response is being sent.
    Responding,
    /// The client receives server-sent events; their duration is not limited.
    Streaming,
}

/// An open connection.
struct Connection {
    state: ConnectionState,
    state_since: Instant,
    /// Address of the client; once it receives events, its token (if any) and address as [`ClientIdentity`].
    client: String,
    /// Ends the task of the connection; `None` until the task is started.
    abort_handle: Option<AbortHandle>,
}

impl Connection {
    fn is_fresh(&self, now: Instant) -> bool {
        self.state == ConnectionState::New
            && now.saturating_duration_since(self.state_since) < FRESH_CONNECTION_DURATION
    }
}

/// All open connections of the server; all clones share one state.
#[derive(Clone)]
struct Connections {
    /// By number, in the order of acceptance.
    open_connections: Arc<Mutex<BTreeMap<u64, Connection>>>,
    /// Permits for large responses, `MAX_CONCURRENT_LARGE_RESPONSES` in number.
    large_response_permits: Arc<Semaphore>,
}

/// An open connection of the server; dropping the guard removes the connection.
struct ConnectionGuard {
    connections: Connections,
    connection_number: u64,
}

impl Drop for ConnectionGuard {
    fn drop(&mut self) {
        self.connections.lock_open_connections().remove(&self.connection_number);
    }
}

impl Connections {
    fn new() -> Self {
        Self {
            open_connections: Arc::default(),
            large_response_permits: Arc::new(Semaphore::new(MAX_CONCURRENT_LARGE_RESPONSES)),
        }
    }

    fn lock_open_connections(&self) -> MutexGuard<'_, BTreeMap<u64, Connection>> {
        lock(&self.open_connections)
    }

    /// Adds a new connection. Where a limit is reached, other connections are closed first; the new one is never
    /// refused.
    fn register_within_limits(&self, number: u64, from: IpAddr, now: Instant) -> ConnectionGuard {
        let mut all = self.lock_open_connections();
        let is_fresh = |connection: &Connection| connection.is_fresh(now);
        let fresh = all.values().filter(|connection| is_fresh(connection)).count();
        let settled = all.len() - fresh;
        if fresh >= MAX_FRESH_CONNECTIONS {
            close_one_candidate(&mut all, is_fresh);
        }
        for _ in MAX_NON_FRESH_CONNECTIONS..=settled {
            close_one_candidate(&mut all, |connection| !is_fresh(connection));
        }
        let (state, client) = (ConnectionState::New, from.to_string());
        all.insert(number, Connection { state, state_since: now, client, abort_handle: None });
        drop(all);
        ConnectionGuard { connections: self.clone(), connection_number: number }
    }

    fn update_connection(&self, number: u64, update: impl FnOnce(&mut Connection)) {
        if let Some(connection) = self.lock_open_connections().get_mut(&number) {
            update(connection);
        }
    }

    /// Sets the state. If there are then too many event streams, one of them is closed.
    fn set_state(&self, number: u64, state: ConnectionState) {
        let mut all = self.lock_open_connections();
        if let Some(connection) = all.get_mut(&number) {
            (connection.state, connection.state_since) = (state, Instant::now());
        }
        let is_streaming = |connection: &Connection| connection.state == ConnectionState::Streaming;
        if state == ConnectionState::Streaming
            && all.values().filter(|connection| is_streaming(connection)).count() > MAX_EVENT_STREAMS
        {
            close_one_candidate(&mut all, is_streaming);
        }
    }

    /// Closes each connection whose request began more than `RESPONSE_TIMEOUT` ago and whose response the client has
    /// not received completely.
    fn close_overdue_responses(&self) {
        let mut all = self.lock_open_connections();
        let is_stuck = |connection: &Connection| {
            connection.state == ConnectionState::Responding && connection.state_since.elapsed() > RESPONSE_TIMEOUT
        };
        while close_one_candidate(&mut all, is_stuck) {}
    }
}

/// Closes one of the connections for which `is_candidate` is true: of those with the lowest [`ConnectionState`], of the
/// client with the most of them, the one that has been in this state for the longest time. Returns whether a connection
/// was closed.
fn close_one_candidate(all: &mut BTreeMap<u64, Connection>, is_candidate: impl Fn(&Connection) -> bool) -> bool {
    let least = all.values().filter(|connection| is_candidate(connection)).map(|connection| connection.state).min();
    let mut shares = BTreeMap::new();
    for (number, connection) in all.iter().filter(|(_, p)| Some(p.state) == least && is_candidate(p)) {
        let (count, oldest) = shares.entry(&connection.client).or_insert((0, (connection.state_since, *number)));
        (*count, *oldest) = (*count + 1, (*oldest).min((connection.state_since, *number)));
    }
    let largest = shares.into_values().max_by_key(|(count, oldest)| (*count, Reverse(*oldest)));
    let closed = largest.and_then(|(_, (_, number))| all.remove(&number));
    let was_closed = closed.is_some();
    if let Some(task) = closed.and_then(|connection| connection.abort_handle) {
        task.abort();
    }
    was_closed
}

/// Accepts and serves connections for as long as the process lives. An error of `accept` is ignored, and `accept` is
/// repeated.
pub async fn accept_connections(listener: TcpListener, router: Router) -> std::io::Result<()> {
    let connections = Connections::new();
    let mut stuck_check = interval(Duration::from_secs(1));
    stuck_check.set_missed_tick_behavior(MissedTickBehavior::Skip);
    for number in 0.. {
        let (stream, from) = loop {
            tokio::select! {
                accepted = listener.accept() => match accepted {
                    Ok(accepted) => break accepted,
                    // The client has disconnected already, or no file descriptor is free: retry later.
                    Err(_) => sleep(Duration::from_millis(50)).await,
                },
                _ = stuck_check.tick() => connections.close_overdue_responses(),
            }
        };
        let guard = connections.register_within_limits(number, from.ip(), Instant::now());
        let task = tokio::spawn(serve_connection(stream, from, router.clone(), guard));
        connections.update_connection(number, |connection| connection.abort_handle = Some(task.abort_handle()));
    }
    Ok(())
}

async fn serve_connection(stream: TcpStream, from: SocketAddr, router: Router, guard: ConnectionGuard) {
    // Responses are small and are sent without delay.
    let _ = stream.set_nodelay(true);
    // The kernel limits the time for data in its send buffer (tcp(7), TCP_USER_TIMEOUT, ms).
    let _ = set_tcp_user_timeout(&stream, RESPONSE_TIMEOUT.as_millis().try_into().unwrap_or(u32::MAX));
    let router = TowerToHyperService::new(router);
    let service = service_fn(|mut request: hyper::Request<Incoming>| {
        let (connections, number) = (guard.connections.clone(), guard.connection_number);
        connections.set_state(number, ConnectionState::Responding);
        request.extensions_mut().insert(ConnectInfo(from));
        let response = router.call(request);
        async move { Ok::<_, Infallible>(connections.track_response(number, response.await.into_response())) }
    });
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(REQUEST_HEAD_TIMEOUT).max_buf_size(MAX_REQUEST_HEAD_BYTES);
    // A client that has closed its sending side may still wait; its request, above all a hold, is executed and logged.
    http.max_headers(MAX_HEADER_FIELDS).half_close(true);
    // An error concerns only this connection.
    let _ = http.serve_connection(TokioIo::new(stream), service).await;
}

impl Connections {
    /// Follows the response until the client has received it: sets the state of the connection, and limits the large
    /// responses.
    fn track_response(&self, number: u64, response: Response) -> Response {
        let content_type = response.headers().get(CONTENT_TYPE).map_or(&[][..], HeaderValue::as_bytes);
        let mut permit = None;
        if content_type.starts_with(b"text/event-stream") {
            if let Some(ClientIdentity(client)) = response.extensions().get() {
                self.update_connection(number, |connection| client.clone_into(&mut connection.client));
            }
            self.set_state(number, ConnectionState::Streaming);
        } else if http_body::Body::size_hint(response.body()).lower() > LARGE_RESPONSE_THRESHOLD_BYTES {
            permit = Arc::clone(&self.large_response_permits).try_acquire_owned().ok();
            if permit.is_none() {
                return self.track_response(number, too_many_large_responses().into_response());
            }
        }
        let connections = self.clone();
        response.map(|body| {
            Body::new(TrackedBody { body, connections, connection_number: number, _large_response_permit: permit })
        })
    }
}

fn too_many_large_responses() -> Problem {
    let status = axum::http::StatusCode::SERVICE_UNAVAILABLE;
    Problem::new(status, "busy", "too many large responses are in progress", "repeat the request in a few seconds")
}

/// Body of a response in progress; dropping it sets the state of its connection to idle.
struct TrackedBody {
    body: Body,
    connections: Connections,
    connection_number: u64,
    /// Held while a large response is in progress; `None` for other responses.
    _large_response_permit: Option<OwnedSemaphorePermit>,
}

impl Drop for TrackedBody {
    fn drop(&mut self) {
        self.connections.set_state(self.connection_number, ConnectionState::Idle);
    }
}

impl http_body::Body for TrackedBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Number of connections of a client, and how many of them receive events.
    fn connection_and_stream_counts(connections: &Connections, client: &str) -> (usize, usize) {
        let all = connections.lock_open_connections();
        let own = all.values().filter(|connection| connection.client == client);
        (own.clone().count(), own.filter(|connection| connection.state == ConnectionState::Streaming).count())
    }

    #[test]
    fn client_with_most_connections_loses_one() {
        let (connections, begun) = (Connections::new(), Instant::now());
        let [few, many] = [[127, 0, 0, 1], [127, 0, 0, 2]].map(IpAddr::from);
        let guard: Vec<ConnectionGuard> =
            (0..3).map(|number| connections.register_within_limits(number, few, begun)).collect();
        let now = begun + 2 * FRESH_CONNECTION_DURATION;
        let crowd: Vec<ConnectionGuard> =
            (10..4000).map(|number| connections.register_within_limits(number, many, now)).collect();
        assert_eq!(
            (
                connection_and_stream_counts(&connections, "127.0.0.1").0,
                connection_and_stream_counts(&connections, "127.0.0.2").0
            ),
            (3, MAX_FRESH_CONNECTIONS)
        );
        let newest = connections.register_within_limits(4000, few, now);
        assert_eq!(
            (
                connection_and_stream_counts(&connections, "127.0.0.1").0,
                connection_and_stream_counts(&connections, "127.0.0.2").0
            ),
            (4, MAX_FRESH_CONNECTIONS - 1)
        );
        // The connections are not fresh any more.
        let next = connections.register_within_limits(4001, few, now + 2 * FRESH_CONNECTION_DURATION);
        assert_eq!(
            (
                connection_and_stream_counts(&connections, "127.0.0.1").0,
                connection_and_stream_counts(&connections, "127.0.0.2").0
            ),
            (5, MAX_NON_FRESH_CONNECTIONS - 5)
        );
        drop((guard, crowd, newest, next));
        assert!(connections.lock_open_connections().is_empty());
    }

    #[test]
    fn responding_and_streaming_connections_are_closed_last() {
        let (connections, mut now) = (Connections::new(), Instant::now());
        let from = IpAddr::from([127, 0, 0, 1]);
        let _taken: Vec<ConnectionGuard> =
            (0..300).map(|number| connections.register_within_limits(number, from, now)).collect();
        let listens = |number: u64, client: &str| {
            connections.update_connection(number, |connection| client.clone_into(&mut connection.client));
            connections.set_state(number, ConnectionState::Streaming);
        };
        listens(0, "tablet");
        (1..=MAX_EVENT_STREAMS as u64 + 2).for_each(|number| listens(number, "crowd"));
        assert_eq!(
            (
                connection_and_stream_counts(&connections, "tablet").1,
                connection_and_stream_counts(&connections, "crowd").1
            ),
            (1, MAX_EVENT_STREAMS - 1)
        );
        connections.set_state(100, ConnectionState::Responding);
        let _more: Vec<ConnectionGuard> = (1000..1600)
            .map(|number| {
                now += 2 * FRESH_CONNECTION_DURATION;
                connections.register_within_limits(number, from, now)
            })
            .collect();
        assert_eq!(connections.lock_open_connections().len(), MAX_NON_FRESH_CONNECTIONS);
        assert_eq!(connections.lock_open_connections()[&100].state, ConnectionState::Responding);
        assert_eq!(
            (
                connection_and_stream_counts(&connections, "tablet").1,
                connection_and_stream_counts(&connections, "crowd").1
            ),
            (1, MAX_EVENT_STREAMS - 1)
        );
    }
}
