//! Who is connected: so many at a time, and each must say what it wants. When all places are taken a new
//! connection gets the place of the one that has been silent longest, of whoever has the most of them. A new
//! one has a second before it may have to make room, so that a hold comes through whatever else is
//! connected; nobody is refused, for it might be the hold. No request and no answer is waited for without end.

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

use super::access::Asker;
use super::problem::Problem;

/// Connections at a time.
const PLACES: usize = 256;
/// Beside them, those that have come within this time and have not asked yet. They cost next to nothing.
const FRESH: Duration = Duration::from_secs(1);
const MOST_FRESH: usize = 512;
/// Of them listeners to events.
const LISTENERS: usize = 64;
/// The head of a request is complete within this time, counted from the end of the one before.
const HEAD: Duration = Duration::from_secs(15);
/// An answer is taken within this time, or its connection closed; events go on for as long as somebody takes
/// them.
const TAKEN: Duration = Duration::from_secs(15);
/// A head is not larger, bytes; nor has it more fields.
const LARGEST_HEAD: usize = 16 * 1024;
const FIELDS: usize = 64;
/// Answers above this size, bytes, of which so many are under way at a time.
const LARGE: u64 = 64 * 1024;
const LARGE_ANSWERS: usize = 16;

/// What a connection does, since when.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Does {
    /// Has not asked yet.
    Comes,
    Waits,
    Answers,
    Tells,
}

struct Place {
    does: Does,
    since: Instant,
    /// Address, or who asks, once that is known.
    whose: String,
    task: Option<AbortHandle>,
}

impl Place {
    fn is_fresh(&self, now: Instant) -> bool {
        self.does == Does::Comes && now.saturating_duration_since(self.since) < FRESH
    }
}

#[derive(Clone)]
struct Places {
    taken: Arc<Mutex<BTreeMap<u64, Place>>>,
    large: Arc<Semaphore>,
}

/// A place at the server, given back when dropped.
struct Taken {
    places: Places,
    number: u64,
}

impl Drop for Taken {
    fn drop(&mut self) {
        self.places.all().remove(&self.number);
    }
}

impl Places {
    fn new() -> Self {
        Self { taken: Arc::default(), large: Arc::new(Semaphore::new(LARGE_ANSWERS)) }
    }

    fn all(&self) -> MutexGuard<'_, BTreeMap<u64, Place>> {
        self.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn take(&self, number: u64, from: IpAddr, now: Instant) -> Taken {
        let mut all = self.all();
        let is_fresh = |place: &Place| place.is_fresh(now);
        let fresh = all.values().filter(|place| is_fresh(place)).count();
        let settled = all.len() - fresh;
        if fresh >= MOST_FRESH {
            close(&mut all, is_fresh);
        }
        for _ in PLACES..=settled {
            close(&mut all, |place| !is_fresh(place));
        }
        let (does, whose) = (Does::Comes, from.to_string());
        all.insert(number, Place { does, since: now, whose, task: None });
        drop(all);
        Taken { places: self.clone(), number }
    }

    fn runs(&self, number: u64, task: AbortHandle) {
        if let Some(place) = self.all().get_mut(&number) {
            place.task = Some(task);
        }
    }

    fn becomes(&self, number: u64, does: Does) {
        let mut all = self.all();
        if let Some(place) = all.get_mut(&number) {
            (place.does, place.since) = (does, Instant::now());
        }
        let tells = |place: &Place| place.does == Does::Tells;
        if does == Does::Tells && all.values().filter(|place| tells(place)).count() > LISTENERS {
            close(&mut all, tells);
        }
    }

    fn is_of(&self, number: u64, whose: &str) {
        if let Some(place) = self.all().get_mut(&number) {
            whose.clone_into(&mut place.whose);
        }
    }

    /// Whose answer nobody takes.
    fn close_stuck(&self) {
        let mut all = self.all();
        let stuck = |place: &Place| place.does == Does::Answers && place.since.elapsed() > TAKEN;
        while close(&mut all, stuck) {}
    }
}

/// One of those who `may` go: of those that do least, of whoever has the most of them, the oldest. Whether
/// there is one.
fn close(all: &mut BTreeMap<u64, Place>, may: impl Fn(&Place) -> bool) -> bool {
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

/// For as long as the process lives.
pub async fn serve(listener: TcpListener, router: Router) -> std::io::Result<()> {
    let places = Places::new();
    let mut second = interval(Duration::from_secs(1));
    second.set_missed_tick_behavior(MissedTickBehavior::Skip);
    for number in 0.. {
        let (stream, from) = loop {
            tokio::select! {
                accepted = listener.accept() => match accepted {
                    Ok(accepted) => break accepted,
                    // It has gone again, or there are no more files: others may close theirs.
                    Err(_) => sleep(Duration::from_millis(50)).await,
                },
                _ = second.tick() => places.close_stuck(),
            }
        };
        let taken = places.take(number, from.ip(), Instant::now());
        let task = tokio::spawn(connection(stream, from, router.clone(), taken));
        places.runs(number, task.abort_handle());
    }
    Ok(())
}

async fn connection(stream: TcpStream, from: SocketAddr, router: Router, taken: Taken) {
    // An answer is small and not waited with.
    let _ = stream.set_nodelay(true);
    // What lies in the kernel already and is not taken: its own to watch (tcp(7), TCP_USER_TIMEOUT, ms).
    let _ = set_tcp_user_timeout(&stream, TAKEN.as_millis().try_into().unwrap_or(u32::MAX));
    let router = TowerToHyperService::new(router);
    let service = service_fn(|mut request: hyper::Request<Incoming>| {
        let (places, number) = (taken.places.clone(), taken.number);
        places.becomes(number, Does::Answers);
        request.extensions_mut().insert(ConnectInfo(from));
        let answer = router.call(request);
        async move { Ok::<_, Infallible>(places.answers(number, answer.await.into_response())) }
    });
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEAD).max_buf_size(LARGEST_HEAD);
    // Who says no more may still wait; and what he has asked for, a hold above all, is done and written down.
    http.max_headers(FIELDS).half_close(true);
    // Whatever ends it concerns this connection alone.
    let _ = http.serve_connection(TokioIo::new(stream), service).await;
}

impl Places {
    fn answers(&self, number: u64, response: Response) -> Response {
        let kind = response.headers().get(CONTENT_TYPE);
        let permit = if kind.is_some_and(|kind| kind.as_bytes().starts_with(b"text/event-stream")) {
            if let Some(Asker(whose)) = response.extensions().get() {
                self.is_of(number, whose);
            }
            self.becomes(number, Does::Tells);
            None
        } else if http_body::Body::size_hint(response.body()).lower() > LARGE {
            match Arc::clone(&self.large).try_acquire_owned() {
                Ok(permit) => Some(permit),
                Err(_) => return self.answers(number, busy().into_response()),
            }
        } else {
            None
        };
        let under_way = UnderWay { places: self.clone(), number, _permit: permit };
        response.map(|body| Body::new(Followed { body, _under_way: under_way }))
    }
}

fn busy() -> Problem {
    let status = axum::http::StatusCode::SERVICE_UNAVAILABLE;
    Problem::new(status, "busy", "too many large answers are being taken", "ask again in a moment")
}

/// Until the answer is taken or given up.
struct UnderWay {
    places: Places,
    number: u64,
    _permit: Option<OwnedSemaphorePermit>,
}

impl Drop for UnderWay {
    fn drop(&mut self) {
        self.places.becomes(self.number, Does::Waits);
    }
}

/// A body that tells when it has gone.
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

    /// Of each address how many are connected, and of them how many tell.
    fn of(places: &Places, whose: &str) -> (usize, usize) {
        let all = places.all();
        let own = all.values().filter(|place| place.whose == whose);
        (own.clone().count(), own.filter(|place| place.does == Does::Tells).count())
    }

    #[test]
    fn whoever_has_the_most_makes_room_and_nobody_else() {
        let (places, begun) = (Places::new(), Instant::now());
        let [few, many] = [[127, 0, 0, 1], [127, 0, 0, 2]].map(IpAddr::from);
        let taken: Vec<Taken> = (0..3).map(|number| places.take(number, few, begun)).collect();
        let now = begun + 2 * FRESH;
        let crowd: Vec<Taken> = (10..4000).map(|number| places.take(number, many, now)).collect();
        assert_eq!((of(&places, "127.0.0.1").0, of(&places, "127.0.0.2").0), (3, MOST_FRESH));
        let newest = places.take(4000, few, now);
        assert_eq!((of(&places, "127.0.0.1").0, of(&places, "127.0.0.2").0), (4, MOST_FRESH - 1));
        // They had their time.
        let next = places.take(4001, few, now + 2 * FRESH);
        assert_eq!((of(&places, "127.0.0.1").0, of(&places, "127.0.0.2").0), (5, PLACES - 5));
        drop((taken, crowd, newest, next));
        assert!(places.all().is_empty());
    }

    #[test]
    fn a_request_under_way_makes_room_last_and_a_listener_for_his_own() {
        let (places, mut now) = (Places::new(), Instant::now());
        let from = IpAddr::from([127, 0, 0, 1]);
        let _taken: Vec<Taken> = (0..300).map(|number| places.take(number, from, now)).collect();
        let listens = |number: u64, whose: &str| {
            places.is_of(number, whose);
            places.becomes(number, Does::Tells);
        };
        listens(0, "tablet");
        (1..=LISTENERS as u64 + 2).for_each(|number| listens(number, "crowd"));
        assert_eq!((of(&places, "tablet").1, of(&places, "crowd").1), (1, LISTENERS - 1));
        places.becomes(100, Does::Answers);
        let _more: Vec<Taken> = (1000..1600)
            .map(|number| {
                now += 2 * FRESH;
                places.take(number, from, now)
            })
            .collect();
        assert_eq!(places.all().len(), PLACES);
        assert_eq!(places.all()[&100].does, Does::Answers);
        assert_eq!((of(&places, "tablet").1, of(&places, "crowd").1), (1, LISTENERS - 1));
    }
}
