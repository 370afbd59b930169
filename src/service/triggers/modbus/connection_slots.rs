//! Connections of the Modbus server: an idle connection is closed, and their number is limited.

use std::future::Future as _;
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::sync::oneshot;
use tokio::time::{Instant, Sleep, sleep};

use crate::service::lock;

/// Maximum time without a received byte; after that, the connection is closed, also if it is half open.
const IDLE_CONNECTION_TIMEOUT: Duration = Duration::from_secs(30);

/// Time without a received byte after which a connection may be replaced by a new one: a control that was switched
/// off leaves a connection that is never closed.
const MIN_QUIET_TIME_TO_REPLACE: Duration = Duration::from_secs(2);

/// The limited set of connections; `capacity`: their maximum number.
pub struct ConnectionSlots {
    capacity: usize,
    occupied: Mutex<Vec<ConnectionSlot>>,
}

/// One open connection.
struct ConnectionSlot {
    /// Time of the last received byte, or of the admission.
    last_received: Arc<Mutex<Instant>>,
    /// Dropping this sender requests the end of the connection; its receiver is dropped when the connection has ended.
    close_request: oneshot::Sender<()>,
}

impl ConnectionSlots {
    pub fn new(capacity: usize) -> Self {
        Self { capacity, occupied: Mutex::default() }
    }

    /// Returns a slot for `stream`. If all are occupied, the connection that has been quiet longest is replaced.
    /// `None`: all are occupied, and none has been quiet for [`MIN_QUIET_TIME_TO_REPLACE`].
    pub fn admit(&self, stream: TcpStream) -> Option<GuardedStream> {
        let mut occupied = lock(&self.occupied);
        occupied.retain(|slot| !slot.close_request.is_closed());
        if occupied.len() >= self.capacity {
            let last_received = |slot: &ConnectionSlot| *lock(&slot.last_received);
            let quietest = occupied.iter().enumerate().min_by_key(|(_, slot)| last_received(slot))?.0;
            if last_received(occupied.get(quietest)?).elapsed() < MIN_QUIET_TIME_TO_REPLACE {
                return None;
            }
            occupied.swap_remove(quietest);
        }
        let last_received = Arc::new(Mutex::new(Instant::now()));
        let (close_request, close_receiver) = oneshot::channel();
        occupied.push(ConnectionSlot { last_received: last_received.clone(), close_request });
        Some(GuardedStream {
            stream,
            idle_timer: Box::pin(sleep(IDLE_CONNECTION_TIMEOUT)),
            last_received,
            close_receiver: Some(close_receiver),
            request_frame: RequestFrame::default(),
        })
    }
}

/// Stream of an admitted connection. Its reads and writes fail when the connection is idle for too long, is replaced,
/// or has received a request at which the Modbus library would panic.
pub struct GuardedStream {
    stream: TcpStream,
    idle_timer: Pin<Box<Sleep>>,
    /// Time of the last received byte, shared with the slot of this connection.
    last_received: Arc<Mutex<Instant>>,
    /// Ready when the connection must be closed; `None` once that has been reported.
    close_receiver: Option<oneshot::Receiver<()>>,
    request_frame: RequestFrame,
}

/// Head of the incoming Modbus TCP request, as far as it is received; empty again after each complete request.
#[derive(Default)]
struct RequestFrame {
    /// First bytes of the request, up to the byte count of a write of several coils.
    first_bytes: Vec<u8>,
    /// Number of bytes of the request that have been received.
    received_byte_count: usize,
}

impl RequestFrame {
    /// Index, from 0, of the byte count in the frame of a write of several coils.
    const BYTE_COUNT_INDEX: usize = 12;
    const WRITE_MULTIPLE_COILS_FUNCTION: u8 = 15;

    /// Adds `byte` to the request. Returns whether it is the byte count of a write of more coils than its bytes can
    /// contain: at such a request tokio-modbus 0.17 panics.
    fn completes_invalid_request(&mut self, byte: u8) -> bool {
        if self.received_byte_count <= Self::BYTE_COUNT_INDEX {
            self.first_bytes.push(byte);
        }
        self.received_byte_count += 1;
        let &[_, _, _, _, n1, n0, ..] = self.first_bytes.as_slice() else { return false };
        let coils = match *self.first_bytes.as_slice() {
            [.., function, _, _, c1, c0, _]
                if self.received_byte_count == Self::BYTE_COUNT_INDEX + 1
                    && function == Self::WRITE_MULTIPLE_COILS_FUNCTION =>
            {
                u16::from_be_bytes([c1, c0])
            }
            _ => 0,
        };
        if self.received_byte_count >= 6 + usize::from(u16::from_be_bytes([n1, n0])) {
            *self = Self::default();
        }
        usize::from(coils) > 8 * usize::from(byte)
    }
}

impl GuardedStream {
    /// Ready when the connection must be closed: a new one replaces it, or it has been idle for too long.
    fn poll_close_request_or_timeout(&mut self, context: &mut Context<'_>) -> Poll<io::Error> {
        let receiver = self.close_receiver.as_mut();
        if receiver.is_none_or(|receiver| Pin::new(receiver).poll(context).is_ready()) {
            // A completed receiver must not be polled again.
            self.close_receiver = None;
            return Poll::Ready(io::ErrorKind::ConnectionAborted.into());
        }
        self.idle_timer.as_mut().poll(context).map(|()| io::ErrorKind::TimedOut.into())
    }
}

impl AsyncRead for GuardedStream {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        match Pin::new(&mut self.stream).poll_read(context, buffer) {
            Poll::Pending => self.poll_close_request_or_timeout(context).map(Err),
            ready => {
                let new_bytes = buffer.filled().get(before..).unwrap_or_default();
                if new_bytes.iter().any(|byte| self.request_frame.completes_invalid_request(*byte)) {
                    return Poll::Ready(Err(io::ErrorKind::InvalidData.into()));
                }
                let now = Instant::now();
                self.idle_timer.as_mut().reset(now + IDLE_CONNECTION_TIMEOUT);
                *lock(&self.last_received) = now;
                ready
            }
        }
    }
}

impl AsyncWrite for GuardedStream {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        match Pin::new(&mut self.stream).poll_write(context, bytes) {
            // A client that does not read its responses is closed too.
            Poll::Pending => self.poll_close_request_or_timeout(context).map(Err),
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
