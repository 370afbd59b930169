//! Who is connected: so many at a time, and each must say what it wants. When all places are taken a new
//! connection gets the place of the one that has been silent longest, so that a hold finds one whatever
//! else is connected; no request and no answer is waited for without end.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::net::SocketAddr;
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
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::AbortHandle;
use tokio::time::{MissedTickBehavior, interval, sleep};

use super::problem::Problem;

/// Connections at a time.
const PLACES: usize = 256;
/// Of them listeners to events.
const LISTENERS: usize = 64;
/// The head of a request is complete within this time, counted from the end of the one before.
const HEAD: Duration = Duration::from_secs(15);
/// An answer is taken within this time, or its connection closed; events go on for as long as they like.
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
    Waits,
    Answers,
    Tells,
}

struct Place {
    does: Does,
    since: Instant,
    task: Option<AbortHandle>,
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

    fn take(&self, number: u64) -> Taken {
        let mut all = self.all();
        if all.len() >= PLACES {
            // Who waits before who is answered, and who listens last; of them the oldest.
            let first = all.iter().min_by_key(|(_, place)| (place.does, place.since));
            let first = first.map(|(number, _)| *number);
            close(&mut all, first);
        }
        all.insert(number, Place { does: Does::Waits, since: Instant::now(), task: None });
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
        let listeners = || all.iter().filter(|(_, place)| place.does == Does::Tells);
        if does == Does::Tells && listeners().count() > LISTENERS {
            let oldest =
                listeners().min_by_key(|(_, place)| place.since).map(|(number, _)| *number);
            close(&mut all, oldest);
        }
    }

    /// Whose answer nobody takes.
    fn close_stuck(&self) {
        let mut all = self.all();
        let stuck = |place: &Place| place.does == Does::Answers && place.since.elapsed() > TAKEN;
        let stuck: Vec<u64> =
            all.iter().filter(|(_, p)| stuck(p)).map(|(number, _)| *number).collect();
        stuck.into_iter().for_each(|number| close(&mut all, Some(number)));
    }
}

fn close(all: &mut BTreeMap<u64, Place>, number: Option<u64>) {
    if let Some(task) = number.and_then(|number| all.remove(&number)).and_then(|place| place.task) {
        task.abort();
    }
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
        let taken = places.take(number);
        let task = tokio::spawn(connection(stream, from, router.clone(), taken));
        places.runs(number, task.abort_handle());
    }
    Ok(())
}

async fn connection(stream: TcpStream, from: SocketAddr, router: Router, taken: Taken) {
    // An answer is small and not waited with.
    let _ = stream.set_nodelay(true);
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
    http.max_headers(FIELDS);
    // Whatever ends it concerns this connection alone.
    let _ = http.serve_connection(TokioIo::new(stream), service).await;
}

impl Places {
    fn answers(&self, number: u64, response: Response) -> Response {
        let kind = response.headers().get(CONTENT_TYPE);
        let permit = if kind.is_some_and(|kind| kind.as_bytes().starts_with(b"text/event-stream")) {
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
