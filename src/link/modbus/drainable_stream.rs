//! The stream that a tokio-modbus context uses. It outlives the context, so that the line can be drained.

use std::fmt;
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, ReadBuf};
use tokio::time::{Instant, timeout_at};

use crate::boxed_stream::BoxedStream;
use crate::stream_owner::poll_once;

/// Maximum number of bytes that are drained without a silence; more cannot be a late reply.
const MAX_DRAIN_BYTES: usize = 16 * 1024;

/// Stream that a context and its owner share; both are on one thread.
#[derive(Clone)]
pub(super) struct DrainableStream(Arc<Mutex<SharedModbusStream>>);

struct SharedModbusStream {
    stream: BoxedStream,
    /// Time of the last byte read or attempt to write; at first the time of creation. The silence is measured from
    /// here.
    last_byte_time: Instant,
}

impl DrainableStream {
    pub(super) fn new(stream: BoxedStream) -> Self {
        Self(Arc::new(Mutex::new(SharedModbusStream { stream, last_byte_time: Instant::now() })))
    }

    fn lock_stream(&self) -> MutexGuard<'_, SharedModbusStream> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Restarts the measurement of the silence.
    pub(super) fn restart_silence_timer(&self) {
        self.lock_stream().last_byte_time = Instant::now();
    }

    /// Drops the bytes that have already arrived, without waiting, and returns their number. (A wait with a timer would
    /// take at least 1 ms.)
    ///
    /// # Errors
    /// The stream has ended, or bytes arrive without end.
    pub(super) async fn discard_arrived_bytes(&mut self) -> io::Result<usize> {
        let mut dropped = 0;
        let mut buffer = [0; 256];
        // The runtime detects bytes that have already arrived only after it has polled the stream.
        tokio::task::yield_now().await;
        loop {
            match poll_once(self.read(&mut buffer)) {
                Poll::Pending => return Ok(dropped),
                Poll::Ready(read) => dropped = add_dropped_count(dropped, read)?,
            }
        }
    }

    /// Drops bytes until `silence` has passed without a byte in either direction, and returns their number.
    ///
    /// # Errors
    /// The stream has ended, or it never becomes silent.
    pub(super) async fn drain_until_silent(&mut self, silence: Duration) -> io::Result<usize> {
        let mut dropped = 0;
        let mut buffer = [0; 256];
        // The runtime detects bytes that have already arrived only after it has polled the stream.
        tokio::task::yield_now().await;
        loop {
            let due = self.lock_stream().last_byte_time + silence;
            match timeout_at(due, self.read(&mut buffer)).await {
                Err(_) => return Ok(dropped),
                Ok(read) => dropped = add_dropped_count(dropped, read)?,
            }
        }
    }
}

/// Adds the number of bytes `read` to `dropped`.
fn add_dropped_count(dropped: usize, read: io::Result<usize>) -> io::Result<usize> {
    match read? {
        0 => Err(io::Error::other("the device closed the connection")),
        count if dropped + count > MAX_DRAIN_BYTES => Err(io::Error::other("the line never becomes silent")),
        count => Ok(dropped + count),
    }
}

/// tokio-modbus requires `Debug` of its stream.
impl fmt::Debug for DrainableStream {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Wire")
    }
}

impl AsyncRead for DrainableStream {
    fn poll_read(self: Pin<&mut Self>, context: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let mut inner = self.lock_stream();
        let before = buffer.filled().len();
        let polled = inner.stream.as_mut().poll_read(context, buffer);
        if buffer.filled().len() > before {
            inner.last_byte_time = Instant::now();
        }
        polled
    }
}

impl AsyncWrite for DrainableStream {
    fn poll_write(self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let mut inner = self.lock_stream();
        inner.last_byte_time = Instant::now();
        inner.stream.as_mut().poll_write(context, bytes)
    }

    fn poll_flush(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.lock_stream().stream.as_mut().poll_flush(context)
    }

    fn poll_shutdown(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.lock_stream().stream.as_mut().poll_shutdown(context)
    }
}
