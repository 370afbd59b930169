//! The one task that owns a byte stream, on a thread of its own. Whatever other threads do, urgent bytes are sent
//! and incoming bytes are read without delay. The handles are channels: a dropped or timed-out future never
//! interrupts an IO operation.

use std::collections::VecDeque;
use std::future::Future;
use std::io;
use std::pin::pin;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadHalf, WriteHalf};
use tokio::sync::{mpsc, oneshot};
use tokio::task::yield_now;
use tokio::time::timeout;

use super::LinkError;
use super::boxed_stream::BoxedStream;
use super::capture::LinkProtocol;
use super::link_mode::LinkMode;

/// Maximum time for the last writes after the handle is dropped.
const FINAL_WRITE_TIMEOUT: Duration = Duration::from_secs(1);

/// Maximum number of reads for one drain of the kernel's buffer.
const MAX_DRAIN_READS: usize = 64;
/// Number of polls without data that are repeated before the kernel's buffer counts as empty.
const MAX_EMPTY_POLL_RETRIES: usize = 2;

/// Receiver of the incoming bytes.
pub(super) trait ByteSink: Send + 'static {
    /// Takes bytes that have just arrived. An error ends the link.
    fn accept_bytes(&mut self, bytes: &[u8]) -> io::Result<()>;
    /// Waits until no receiver is left.
    fn wait_for_no_readers(&self) -> impl Future<Output = ()> + Send;
    /// Reports the reason for the lost link, as the last message.
    fn report_loss(self, why: String) -> impl Future<Output = ()> + Send;
}

pub(super) struct UrgentMessage {
    pub(super) bytes: Vec<u8>,
    /// Whether everything non-urgent, queued now or later, is dropped. A partly written message is still completed.
    pub(super) drops_non_urgent: bool,
}

/// Receiving ends of the handles' channels.
pub(super) struct OwnerChannels<K> {
    pub(super) sink: K,
    pub(super) outgoing: mpsc::UnboundedReceiver<Vec<u8>>,
    pub(super) urgent_queue: mpsc::UnboundedReceiver<UrgentMessage>,
    /// Callers to be notified once all bytes that have already arrived are passed to the sink.
    pub(super) drain_requests: mpsc::UnboundedReceiver<oneshot::Sender<()>>,
}

/// Starts the thread that owns the stream of the link `name` to its end. Returns a future that waits until `open`
/// has opened the stream.
pub(super) fn start_stream_owner_thread(
    name: &str,
    channels: OwnerChannels<impl ByteSink>,
    open: impl Future<Output = Result<BoxedStream, LinkError>> + Send + 'static,
) -> impl Future<Output = Result<(), LinkError>> {
    let backend = LinkMode::current().backend_for_link(name, LinkProtocol::Lines);
    let opening = async move { backend.open(open).await };
    spawn_owner_thread("link", name, opening, |stream| StreamOwner::new(stream, channels).run())
}

/// Starts a thread that runs `open` and, if it succeeds, `run` with its result. Returns a future that waits for the
/// result of `open`; `address` is the address in error messages.
pub(super) fn spawn_owner_thread<T, E, R>(
    thread_name: &str,
    address: &str,
    open: impl Future<Output = Result<T, E>> + Send + 'static,
    run: impl FnOnce(T) -> R + Send + 'static,
) -> impl Future<Output = Result<(), E>>
where
    T: Send,
    E: From<LinkError> + Send + 'static,
    R: Future<Output = ()> + Send,
{
    let (opened, result) = oneshot::channel();
    let start = || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let owner_task = async move {
            match open.await {
                Ok(link) => {
                    let _ = opened.send(Ok(()));
                    run(link).await;
                }
                Err(error) => drop(opened.send(Err(error))),
            }
        };
        std::thread::Builder::new().name(thread_name.to_owned()).spawn(move || runtime.block_on(owner_task))
    };
    let (started, address) = (start(), address.to_owned());
    async move {
        let open_error = |source| LinkError::OpenFailed { address: address.clone(), source };
        started.map_err(open_error)?;
        result.await.map_err(|_| open_error(io::Error::other("the thread of the link has ended")))?
    }
}

/// State of the owning task.
pub(super) struct StreamOwner<S, K> {
    reader: ReadHalf<S>,
    writer: WriteHalf<S>,
    channels: OwnerChannels<K>,
    /// Whether a hold was sent: only urgent bytes are sent now.
    sends_urgent_only: bool,
    /// Messages to be written; a part of the first message may already be written.
    write_queue: VecDeque<QueuedWrite>,
}

/// Outgoing bytes that are not completely written yet.
struct QueuedWrite {
    bytes: Vec<u8>,
    written_byte_count: usize,
    is_urgent: bool,
}

impl<S: AsyncRead + AsyncWrite, K: ByteSink> StreamOwner<S, K> {
    pub(super) fn new(stream: S, channels: OwnerChannels<K>) -> Self {
        let (reader, writer) = tokio::io::split(stream);
        Self { reader, writer, channels, sends_urgent_only: false, write_queue: VecDeque::new() }
    }

    /// Transfers bytes until the handle is dropped, then sends what is queued; or until the link is lost, then
    /// reports why.
    pub(super) async fn run(mut self) {
        let end = self.transfer_until_closed().await;
        let why = match end {
            Ok(()) => {
                self.flush_queues().await;
                return;
            }
            Err(error) => error.to_string(),
        };
        self.channels.sink.report_loss(why).await;
    }

    /// Reads and writes until the handle is dropped (`Ok`) or the link is lost.
    async fn transfer_until_closed(&mut self) -> io::Result<()> {
        let mut buffer = [0; 4096];
        loop {
            // `read`, `write` and `recv` are cancel safe: a branch that is not taken has moved no byte.
            tokio::select! {
                biased;
                Some(message) = self.channels.urgent_queue.recv() => self.queue_urgent(message),
                written = write_first_queued(&mut self.writer, &self.write_queue), if !self.write_queue.is_empty() => {
                    remove_written_bytes(&mut self.write_queue, written?);
                }
                message = self.channels.outgoing.recv(), if self.write_queue.is_empty() => match message {
                    Some(_) if self.sends_urgent_only => {}
                    Some(bytes) => self.write_queue.push_back(QueuedWrite { bytes, written_byte_count: 0, is_urgent: false }),
                    None => return Ok(()),
                },
                // If the peer has stopped reading, the write queue never becomes empty, and `outgoing` is not polled.
                () = self.channels.sink.wait_for_no_readers() => return Ok(()),
                Some(notify) = self.channels.drain_requests.recv() => {
                    self.drain_arrived_bytes(&mut buffer).await?;
                    let _ = notify.send(());
                }
                read = self.reader.read(&mut buffer) => {
                    let count = read?;
                    self.pass_bytes_to_sink(&buffer, count)?;
                }
            }
        }
    }

    /// Passes the `count` bytes of one read to the sink. A read of 0 bytes is the end of the stream, an error.
    fn pass_bytes_to_sink(&mut self, buffer: &[u8], count: usize) -> io::Result<()> {
        if count == 0 {
            return Err(io::Error::other("the device closed the connection"));
        }
        self.channels.sink.accept_bytes(buffer.get(..count).unwrap_or_default())
    }

    /// Reads all bytes in the kernel's buffer, but at most `MAX_DRAIN_READS` times, because a device may send without
    /// pauses.
    async fn drain_arrived_bytes(&mut self, buffer: &mut [u8]) -> io::Result<()> {
        let mut empty_poll_count = 0;
        for _ in 0..MAX_DRAIN_READS {
            // Cancel safe: a read that is not ready has moved no byte.
            match poll_once(self.reader.read(buffer)) {
                Poll::Ready(count) => {
                    let count = count?;
                    self.pass_bytes_to_sink(buffer, count)?;
                    empty_poll_count = 0;
                }
                // The runtime polls the kernel before the next read.
                Poll::Pending if empty_poll_count < MAX_EMPTY_POLL_RETRIES => {
                    empty_poll_count += 1;
                    yield_now().await;
                }
                Poll::Pending => break,
            }
        }
        Ok(())
    }

    /// Inserts a message after a partly written message and earlier urgent messages, but before all others.
    fn queue_urgent(&mut self, message: UrgentMessage) {
        let has_precedence = |message: &&QueuedWrite| message.is_urgent || message.written_byte_count > 0;
        let index = self.write_queue.iter().take_while(has_precedence).count();
        if message.drops_non_urgent {
            self.sends_urgent_only = true;
            self.write_queue.truncate(index);
        }
        self.write_queue.insert(index, QueuedWrite { bytes: message.bytes, written_byte_count: 0, is_urgent: true });
    }

    /// Sends what is queued when the handle is dropped, including a hold.
    async fn flush_queues(&mut self) {
        while let Ok(bytes) = self.channels.outgoing.try_recv() {
            if self.sends_urgent_only {
                continue;
            }
            self.write_queue.push_back(QueuedWrite { bytes, written_byte_count: 0, is_urgent: false });
        }
        while let Ok(message) = self.channels.urgent_queue.try_recv() {
            self.queue_urgent(message);
        }
        let write = async {
            while !self.write_queue.is_empty() {
                match write_first_queued(&mut self.writer, &self.write_queue).await {
                    Ok(count) => remove_written_bytes(&mut self.write_queue, count),
                    Err(_) => return,
                }
            }
        };
        // The stream is closed afterwards in any case.
        let _ = timeout(FINAL_WRITE_TIMEOUT, write).await;
    }
}

/// Polls `future` once, without waiting for it.
pub(super) fn poll_once<F: Future>(future: F) -> Poll<F::Output> {
    pin!(future).poll(&mut Context::from_waker(Waker::noop()))
}

/// Writes a part of the first message, or all of it; returns the number of bytes written.
async fn write_first_queued<S: AsyncWrite>(
    writer: &mut WriteHalf<S>,
    write_queue: &VecDeque<QueuedWrite>,
) -> io::Result<usize> {
    let Some(message) = write_queue.front() else { return Ok(0) };
    let count = writer.write(&message.bytes[message.written_byte_count..]).await?;
    if count == 0 && !message.bytes.is_empty() {
        return Err(io::ErrorKind::WriteZero.into());
    }
    Ok(count)
}

/// Counts `count` more bytes of the first message as written; removes the message once it is complete.
fn remove_written_bytes(write_queue: &mut VecDeque<QueuedWrite>, count: usize) {
    let Some(message) = write_queue.front_mut() else { return };
    message.written_byte_count += count;
    if message.written_byte_count >= message.bytes.len() {
        write_queue.pop_front();
    }
}
