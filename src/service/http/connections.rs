//! Connections of the HTTP server. Their number is limited, and every wait for a request or a response has a time
//! limit. When all places are taken, a new connection replaces another one, preferably one without a request in
//! progress: of the client with the most connections, the oldest. A new connection has one second to send its
//! request before it can be replaced, so that a hold arrives however many clients are connected. No connection is
//! refused, because it might carry a hold.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::convert::Infallible;
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::ConnectInfo;
use axum::http::header::CONTENT_TYPE;
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

/// Maximum number of connections, without the fresh ones.
const PLACES: usize = 256;
/// Time for which a new connection without a request counts as fresh; fresh connections use few resources.
const FRESH: Duration = Duration::from_secs(1);
const MOST_FRESH: usize = 512;
/// Maximum number of connections that receive events.
const LISTENERS: usize = 64;
/// Maximum time to receive the head of a request, from the end of the previous request.
const HEADER_TIMEOUT: Duration = Duration::from_secs(15);
/// Maximum time for the client to receive a response; after that, the connection is closed. Events continue for as
/// long as the client receives them.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(15);
/// Maximum size of the head of a request, bytes; [`FIELDS`] is its maximum number of header fields.
const LARGEST_HEAD: usize = 16 * 1024;
const FIELDS: usize = 64;
/// Size above which a response is large, bytes; [`LARGE_ANSWERS`] is the maximum number of large ones at a time.
const LARGE_RESPONSE_BYTES: u64 = 64 * 1024;
const LARGE_ANSWERS: usize = 16;

/// State of a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum ConnectionState {
    /// No request yet.
    New,
    Idle,
    Responding,
    Streaming,
}

struct Connection {
    does: ConnectionState,
    since: Instant,
    /// Address of the client, or its identity once that is known.
    whose: String,
    task: Option<AbortHandle>,
}

impl Connection {
    fn is_fresh(&self, now: Instant) -> bool {
        self.does == ConnectionState::New && now.saturating_duration_since(self.since) < FRESH
    }
}

#[derive(Clone)]
struct Connections {
    taken: Arc<Mutex<BTreeMap<u64, Connection>>>,
    large: Arc<Semaphore>,
}

/// A place at the server; dropping it frees the place.
struct ConnectionGuard {
    connections: Connections,
    number: u64,
}

impl Drop for ConnectionGuard {
    fn drop(&mut self) {
        self.connections.all().remove(&self.number);
    }
}

impl Connections {
    fn new() -> Self {
        Self { taken: Arc::default(), large: Arc::new(Semaphore::new(LARGE_ANSWERS)) }
    }

    fn all(&self) -> MutexGuard<'_, BTreeMap<u64, Connection>> {
        self.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn take(&self, number: u64, from: IpAddr, now: Instant) -> ConnectionGuard {
        let mut all = self.all();
        let is_fresh = |place: &Connection| place.is_fresh(now);
        let fresh = all.values().filter(|place| is_fresh(place)).count();
        let settled = all.len() - fresh;
        if fresh >= MOST_FRESH {
            close(&mut all, is_fresh);
        }
        for _ in PLACES..=settled {
            close(&mut all, |place| !is_fresh(place));
        }
        let (does, whose) = (ConnectionState::New, from.to_string());
        all.insert(number, Connection { does, since: now, whose, task: None });
        drop(all);
        ConnectionGuard { connections: self.clone(), number }
    }

    fn runs(&self, number: u64, task: AbortHandle) {
        if let Some(place) = self.all().get_mut(&number) {
            place.task = Some(task);
        }
    }

    fn becomes(&self, number: u64, does: ConnectionState) {
        let mut all = self.all();
        if let Some(place) = all.get_mut(&number) {
            (place.does, place.since) = (does, Instant::now());
        }
        let tells = |place: &Connection| place.does == ConnectionState::Streaming;
        if does == ConnectionState::Streaming
            && all.values().filter(|place| tells(place)).count() > LISTENERS
        {
            close(&mut all, tells);
        }
    }

    fn is_of(&self, number: u64, whose: &str) {
        if let Some(place) = self.all().get_mut(&number) {
            whose.clone_into(&mut place.whose);
        }
    }

    /// Closes the connections whose client does not receive the response in time.
    fn close_stuck(&self) {
        let mut all = self.all();
        let stuck = |place: &Connection| {
            place.does == ConnectionState::Responding && place.since.elapsed() > RESPONSE_TIMEOUT
        };
        while close(&mut all, stuck) {}
    }
}

/// Closes one of the connections for which `may` is true. Candidates are those with the lowest [`ConnectionState`]; of these,
/// the oldest of the client with the most connections is closed. Returns whether one was closed.
fn close(all: &mut BTreeMap<u64, Connection>, may: impl Fn(&Connection) -> bool) -> bool {
    let least = all.values().filter(|place| may(place)).map(|place| place.does).min();
    let mut shares = BTreeMap::new();
    for (number, place) in all.iter().filter(|(_, p)| Some(p.does) == least && may(p)) {
        let (count, oldest) = shares.entry(&place.whose).or_insert((0, (place.since, *number)));
        (*count, *oldest) = (*count + 1, (*oldest).min((place.since, *number)));
    }
    let largest = shares.into_values().max_by_key(|(count, oldest)| (*count, Reverse(*oldest)));
    let gone = largest.and_then(|(_, (_, number))| all.remove(&number));
    let found = gone.is_some();
    if let Some(task) = gone.and_then(|place| place.task) {
        task.abort();
    }
    found
}

/// Serves for as long as the process lives.
pub async fn serve(listener: TcpListener, router: Router) -> std::io::Result<()> {
    let connections = Connections::new();
    let mut second = interval(Duration::from_secs(1));
    second.set_missed_tick_behavior(MissedTickBehavior::Skip);
    for number in 0.. {
        let (stream, from) = loop {
            tokio::select! {
                accepted = listener.accept() => match accepted {
                    Ok(accepted) => break accepted,
                    // The client has disconnected already, or no file descriptor is free: retry later.
                    Err(_) => sleep(Duration::from_millis(50)).await,
                },
                _ = second.tick() => connections.close_stuck(),
            }
        };
        let taken = connections.take(number, from.ip(), Instant::now());
        let task = tokio::spawn(connection(stream, from, router.clone(), taken));
        connections.runs(number, task.abort_handle());
    }
    Ok(())
}

async fn connection(stream: TcpStream, from: SocketAddr, router: Router, taken: ConnectionGuard) {
    // Responses are small and are sent without delay.
    let _ = stream.set_nodelay(true);
    // The kernel limits the time for data in its send buffer (tcp(7), TCP_USER_TIMEOUT, ms).
    let _ =
        set_tcp_user_timeout(&stream, RESPONSE_TIMEOUT.as_millis().try_into().unwrap_or(u32::MAX));
    let router = TowerToHyperService::new(router);
    let service = service_fn(|mut request: hyper::Request<Incoming>| {
        let (connections, number) = (taken.connections.clone(), taken.number);
        connections.becomes(number, ConnectionState::Responding);
        request.extensions_mut().insert(ConnectInfo(from));
        let answer = router.call(request);
        async move { Ok::<_, Infallible>(connections.answers(number, answer.await.into_response())) }
    });
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEADER_TIMEOUT).max_buf_size(LARGEST_HEAD);
    // A client that has closed its sending side may still wait; its request, above all a hold, is executed and logged.
    http.max_headers(FIELDS).half_close(true);
    // An error concerns only this connection.
    let _ = http.serve_connection(TokioIo::new(stream), service).await;
}

impl Connections {
    fn answers(&self, number: u64, response: Response) -> Response {
        let kind = response.headers().get(CONTENT_TYPE);
        let permit = if kind.is_some_and(|kind| kind.as_bytes().starts_with(b"text/event-stream")) {
            if let Some(ClientIdentity(whose)) = response.extensions().get() {
                self.is_of(number, whose);
            }
            self.becomes(number, ConnectionState::Streaming);
            None
        } else if http_body::Body::size_hint(response.body()).lower() > LARGE_RESPONSE_BYTES {
            match Arc::clone(&self.large).try_acquire_owned() {
                Ok(permit) => Some(permit),
                Err(_) => return self.answers(number, busy().into_response()),
            }
        } else {
            None
        };
        let under_way = UnderWay { connections: self.clone(), number, _permit: permit };
        response.map(|body| Body::new(Followed { body, _under_way: under_way }))
    }
}

fn busy() -> Problem {
    let status = axum::http::StatusCode::SERVICE_UNAVAILABLE;
    Problem::new(status, "busy", "too many large answers are being taken", "ask again in a moment")
}

/// Marks a response in progress, until it is received or given up.
struct UnderWay {
    connections: Connections,
    number: u64,
    _permit: Option<OwnedSemaphorePermit>,
}

impl Drop for UnderWay {
    fn drop(&mut self) {
        self.connections.becomes(self.number, ConnectionState::Idle);
    }
}

/// A response body that detects its own end.
struct Followed {
    body: Body,
    _under_way: UnderWay,
}

impl http_body::Body for Followed {
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
    fn of(connections: &Connections, whose: &str) -> (usize, usize) {
        let all = connections.all();
        let own = all.values().filter(|place| place.whose == whose);
        (own.clone().count(), own.filter(|place| place.does == ConnectionState::Streaming).count())
    }

    #[test]
    fn whoever_has_the_most_makes_room_and_nobody_else() {
        let (connections, begun) = (Connections::new(), Instant::now());
        let [few, many] = [[127, 0, 0, 1], [127, 0, 0, 2]].map(IpAddr::from);
        let taken: Vec<ConnectionGuard> =
            (0..3).map(|number| connections.take(number, few, begun)).collect();
        let now = begun + 2 * FRESH;
        let crowd: Vec<ConnectionGuard> =
            (10..4000).map(|number| connections.take(number, many, now)).collect();
        assert_eq!(
            (of(&connections, "127.0.0.1").0, of(&connections, "127.0.0.2").0),
            (3, MOST_FRESH)
        );
        let newest = connections.take(4000, few, now);
        assert_eq!(
            (of(&connections, "127.0.0.1").0, of(&connections, "127.0.0.2").0),
            (4, MOST_FRESH - 1)
        );
        // The connections are not fresh any more.
        let next = connections.take(4001, few, now + 2 * FRESH);
        assert_eq!(
            (of(&connections, "127.0.0.1").0, of(&connections, "127.0.0.2").0),
            (5, PLACES - 5)
        );
        drop((taken, crowd, newest, next));
        assert!(connections.all().is_empty());
    }

    #[test]
    fn a_request_under_way_makes_room_last_and_a_listener_for_his_own() {
        let (connections, mut now) = (Connections::new(), Instant::now());
        let from = IpAddr::from([127, 0, 0, 1]);
        let _taken: Vec<ConnectionGuard> =
            (0..300).map(|number| connections.take(number, from, now)).collect();
        let listens = |number: u64, whose: &str| {
            connections.is_of(number, whose);
            connections.becomes(number, ConnectionState::Streaming);
        };
        listens(0, "tablet");
        (1..=LISTENERS as u64 + 2).for_each(|number| listens(number, "crowd"));
        assert_eq!((of(&connections, "tablet").1, of(&connections, "crowd").1), (1, LISTENERS - 1));
        connections.becomes(100, ConnectionState::Responding);
        let _more: Vec<ConnectionGuard> = (1000..1600)
            .map(|number| {
                now += 2 * FRESH;
                connections.take(number, from, now)
            })
            .collect();
        assert_eq!(connections.all().len(), PLACES);
        assert_eq!(connections.all()[&100].does, ConnectionState::Responding);
        assert_eq!((of(&connections, "tablet").1, of(&connections, "crowd").1), (1, LISTENERS - 1));
    }
}
