//! The one task that owns a byte stream, on a thread of its own. Whatever other threads do, urgent bytes are sent
//! and incoming bytes are read without delay. The handles are channels: a dropped or timed-out future never
//! interrupts an IO operation.

use std::collections::VecDeque;
use std::future::{Future, poll_fn};
use std::io;
use std::pin::pin;
use std::task::Poll;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadHalf, WriteHalf};
use tokio::sync::{mpsc, oneshot};
use tokio::task::yield_now;
use tokio::time::timeout;

use super::LinkError;

/// Maximum time for the last writes after the handle is dropped.
const FINAL_WRITE_TIMEOUT: Duration = Duration::from_secs(1);

/// Maximum number of reads that empty the kernel's buffer, and the number of consecutive polls without data after
/// which it counts as empty.
const MAX_DRAIN_READS: usize = 64;
const EMPTY_POLLS: usize = 2;

/// Receiver of the incoming bytes.
pub(super) trait Sink: Send + 'static {
    /// Takes bytes that have just arrived. An error ends the link.
    fn take(&mut self, bytes: &[u8]) -> io::Result<()>;
    /// Ends when no reader is left.
    fn unwanted(&self) -> impl Future<Output = ()> + Send;
    /// Reports the reason for the lost link, as the last message.
    fn lost(self, why: String) -> impl Future<Output = ()> + Send;
}

pub(super) struct UrgentMessage {
    pub(super) bytes: Vec<u8>,
    pub(super) last: bool,
}

/// Receiving ends of the handles' channels.
pub(super) struct Ends<K> {
    pub(super) sink: K,
    pub(super) queued: mpsc::UnboundedReceiver<Vec<u8>>,
    pub(super) urgent_queue: mpsc::UnboundedReceiver<UrgentMessage>,
    /// Callers to be notified once all bytes that have already arrived are passed to the sink.
    pub(super) emptied: mpsc::UnboundedReceiver<oneshot::Sender<()>>,
}

/// Starts a thread that opens a stream, reports the result, and owns the stream to its end.
pub(super) fn start<S: AsyncRead + AsyncWrite + Send + 'static>(
    ends: Ends<impl Sink>,
    open: impl Future<Output = Result<S, LinkError>> + Send + 'static,
    opened: oneshot::Sender<Result<(), LinkError>>,
) -> io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let own = async move {
        let stream = match open.await {
            Ok(stream) => stream,
            Err(error) => return drop(opened.send(Err(error))),
        };
        let _ = opened.send(Ok(()));
        Owner::new(stream, ends).run().await;
    };
    std::thread::Builder::new().name("link".to_owned()).spawn(move || runtime.block_on(own))?;
    Ok(())
}

/// State of the owning task.
pub(super) struct Owner<S, K> {
    reader: ReadHalf<S>,
    writer: WriteHalf<S>,
    ends: Ends<K>,
    /// After a hold, only urgent bytes are sent.
    closed: bool,
    /// Messages to be written; a part of the first message may already be written.
    pending: VecDeque<Message>,
}

struct Message {
    bytes: Vec<u8>,
    written: usize,
    urgent: bool,
}

impl<S: AsyncRead + AsyncWrite, K: Sink> Owner<S, K> {
    pub(super) fn new(stream: S, ends: Ends<K>) -> Self {
        let (reader, writer) = tokio::io::split(stream);
        Self { reader, writer, ends, closed: false, pending: VecDeque::new() }
    }

    pub(super) async fn run(mut self) {
        let end = self.pump().await;
        let why = match end {
            Ok(()) => {
                self.say_last_words().await;
                return;
            }
            Err(error) => error.to_string(),
        };
        self.ends.sink.lost(why).await;
    }

    /// Reads and writes until the handle is dropped (`Ok`) or the link is lost.
    async fn pump(&mut self) -> io::Result<()> {
        let mut buffer = [0; 4096];
        loop {
            // `read`, `write` and `recv` are cancel safe: a branch that is not taken has moved no byte.
            tokio::select! {
                biased;
                Some(ahead) = self.ends.urgent_queue.recv() => self.put_ahead(ahead),
                written = write_some(&mut self.writer, &self.pending), if !self.pending.is_empty() => {
                    advance(&mut self.pending, written?);
                }
                message = self.ends.queued.recv(), if self.pending.is_empty() => match message {
                    Some(_) if self.closed => {}
                    Some(bytes) => self.pending.push_back(Message { bytes, written: 0, urgent: false }),
                    None => return Ok(()),
                },
                // If the peer has stopped reading, the queue never becomes empty.
                () = self.ends.sink.unwanted() => return Ok(()),
                Some(told) = self.ends.emptied.recv() => {
                    self.take_waiting(&mut buffer).await?;
                    let _ = told.send(());
                }
                read = self.reader.read(&mut buffer) => {
                    let count = read?;
                    self.leave(&buffer, count)?;
                }
            }
        }
    }

    fn leave(&mut self, buffer: &[u8], count: usize) -> io::Result<()> {
        if count == 0 {
            return Err(io::Error::other("the other side closed it"));
        }
        self.ends.sink.take(buffer.get(..count).unwrap_or_default())
    }

    /// Reads all bytes in the kernel's buffer. Of a device that never pauses, it reads at most what fits into that
    /// buffer.
    async fn take_waiting(&mut self, buffer: &mut [u8]) -> io::Result<()> {
        let mut quiet = 0;
        for _ in 0..MAX_DRAIN_READS {
            let mut read = pin!(self.reader.read(buffer));
            // Cancel safe: a read that is not ready has moved no byte.
            match poll_fn(|context| Poll::Ready(read.as_mut().poll(context))).await {
                Poll::Ready(count) => {
                    let count = count?;
                    self.leave(buffer, count)?;
                    quiet = 0;
                }
                // The runtime polls the kernel before the next read.
                Poll::Pending if quiet < EMPTY_POLLS => {
                    quiet += 1;
                    yield_now().await;
                }
                Poll::Pending => break,
            }
        }
        Ok(())
    }

    /// Inserts a message after a partly written message and earlier urgent messages, but before all others.
    fn put_ahead(&mut self, ahead: UrgentMessage) {
        let goes_first = |message: &&Message| message.urgent || message.written > 0;
        let place = self.pending.iter().take_while(goes_first).count();
        if ahead.last {
            self.closed = true;
            self.pending.truncate(place);
        }
        self.pending.insert(place, Message { bytes: ahead.bytes, written: 0, urgent: true });
    }

    /// Sends what is queued when the handle is dropped, including a hold.
    async fn say_last_words(&mut self) {
        while let Ok(bytes) = self.ends.queued.try_recv() {
            if self.closed {
                continue;
            }
            self.pending.push_back(Message { bytes, written: 0, urgent: false });
        }
        while let Ok(ahead) = self.ends.urgent_queue.try_recv() {
            self.put_ahead(ahead);
        }
        let write = async {
            while !self.pending.is_empty() {
                match write_some(&mut self.writer, &self.pending).await {
                    Ok(count) => advance(&mut self.pending, count),
                    Err(_) => return,
                }
            }
        };
        // The stream is closed afterwards in any case.
        let _ = timeout(FINAL_WRITE_TIMEOUT, write).await;
    }
}

async fn write_some<S: AsyncWrite>(
    writer: &mut WriteHalf<S>,
    pending: &VecDeque<Message>,
) -> io::Result<usize> {
    let Some(message) = pending.front() else { return Ok(0) };
    let count = writer.write(&message.bytes[message.written..]).await?;
    if count == 0 && !message.bytes.is_empty() {
        return Err(io::ErrorKind::WriteZero.into());
    }
    Ok(count)
}

fn advance(pending: &mut VecDeque<Message>, count: usize) {
    let Some(message) = pending.front_mut() else { return };
    message.written += count;
    if message.written >= message.bytes.len() {
        pending.pop_front();
    }
}
