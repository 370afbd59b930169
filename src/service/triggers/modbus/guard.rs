//! Watched connections: an idle connection is closed, and the number of connections is limited.

use std::future::Future as _;
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::sync::oneshot;
use tokio::time::{Instant, Sleep, sleep};

/// Maximum time without a received byte; after that, the connection is closed, also if it is half open.
const IDLE: Duration = Duration::from_secs(30);

/// Time without a received byte after which a connection may be replaced by a new one: a control that was switched
/// off leaves a connection that is never closed.
const QUIET: Duration = Duration::from_secs(2);

/// The limited set of connections.
pub struct Places {
    size: usize,
    taken: Mutex<Vec<Place>>,
}

struct Place {
    heard: Arc<Mutex<Instant>>,
    /// Dropping it requests that the connection closes; the receiver is closed once the connection is.
    leave: oneshot::Sender<()>,
}

impl Places {
    pub fn new(size: usize) -> Self {
        Self { size, taken: Mutex::default() }
    }

    /// Returns a place for `stream`. If all are taken, the connection that has been quiet longest is replaced.
    /// `None`: no connection was quiet.
    pub fn seat(&self, stream: TcpStream) -> Option<Guarded> {
        let mut taken = self.taken.lock().unwrap_or_else(PoisonError::into_inner);
        taken.retain(|place| !place.leave.is_closed());
        if taken.len() >= self.size {
            let heard = |place: &Place| at(&place.heard);
            let quietest = taken.iter().enumerate().min_by_key(|(_, place)| heard(place))?.0;
            if heard(taken.get(quietest)?).elapsed() < QUIET {
                return None;
            }
            taken.swap_remove(quietest);
        }
        let heard = Arc::new(Mutex::new(Instant::now()));
        let (leave, asked_to_leave) = oneshot::channel();
        taken.push(Place { heard: heard.clone(), leave });
        Some(Guarded {
            stream,
            idle: Box::pin(sleep(IDLE)),
            heard,
            asked_to_leave: Some(asked_to_leave),
            frame: Frame::default(),
        })
    }
}

fn at(heard: &Mutex<Instant>) -> Instant {
    *heard.lock().unwrap_or_else(PoisonError::into_inner)
}

pub struct Guarded {
    stream: TcpStream,
    idle: Pin<Box<Sleep>>,
    heard: Arc<Mutex<Instant>>,
    asked_to_leave: Option<oneshot::Receiver<()>>,
    frame: Frame,
}

/// Head of the incoming request, as far as it is received.
#[derive(Default)]
struct Frame {
    head: Vec<u8>,
    bytes: usize,
}

impl Frame {
    const BYTE_COUNT: usize = 12;
    const WRITE_COILS: u8 = 15;

    /// Whether `byte` completes a request at which tokio-modbus 0.17 panics: more coils than its bytes can contain.
    fn is_spoilt_by(&mut self, byte: u8) -> bool {
        if self.bytes <= Self::BYTE_COUNT {
            self.head.push(byte);
        }
        self.bytes += 1;
        let &[_, _, _, _, n1, n0, ..] = self.head.as_slice() else { return false };
        let coils = match *self.head.as_slice() {
            [.., function, _, _, c1, c0, _]
                if self.bytes == Self::BYTE_COUNT + 1 && function == Self::WRITE_COILS =>
            {
                u16::from_be_bytes([c1, c0])
            }
            _ => 0,
        };
        if self.bytes >= 6 + usize::from(u16::from_be_bytes([n1, n0])) {
            *self = Self::default();
        }
        usize::from(coils) > 8 * usize::from(byte)
    }
}

impl Guarded {
    fn idle(&mut self, context: &mut Context<'_>) -> Poll<io::Error> {
        let asked = self.asked_to_leave.as_mut();
        if asked.is_none_or(|asked| Pin::new(asked).poll(context).is_ready()) {
            // A completed receiver must not be polled again.
            self.asked_to_leave = None;
            return Poll::Ready(io::ErrorKind::ConnectionAborted.into());
        }
        self.idle.as_mut().poll(context).map(|()| io::ErrorKind::TimedOut.into())
    }
}

impl AsyncRead for Guarded {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        match Pin::new(&mut self.stream).poll_read(context, buffer) {
            Poll::Pending => self.idle(context).map(Err),
            ready => {
                let came = buffer.filled().get(before..).unwrap_or_default();
                if came.iter().any(|byte| self.frame.is_spoilt_by(*byte)) {
                    return Poll::Ready(Err(io::ErrorKind::InvalidData.into()));
                }
                let now = Instant::now();
                self.idle.as_mut().reset(now + IDLE);
                *self.heard.lock().unwrap_or_else(PoisonError::into_inner) = now;
                ready
            }
        }
    }
}

impl AsyncWrite for Guarded {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        match Pin::new(&mut self.stream).poll_write(context, bytes) {
            // A client that does not read its responses is closed too.
            Poll::Pending => self.idle(context).map(Err),
            ready => ready,
        }
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}
