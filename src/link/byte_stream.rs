//! Byte stream of a device that sends without a request: each read with its time. The reader may fall behind; the
//! queue then drops the oldest reads. Several handles may share one stream: each handle receives all bytes.

use std::future::Future;
use std::io;
use std::sync::{Arc, Weak};

use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::{Mutex, broadcast, mpsc, oneshot};
use tokio::time::{Instant, timeout_at};

use super::LinkError;
use super::boxed_stream::BoxedStream;
use super::stream_owner::{ByteSink, OwnerChannels, StreamOwner, start_stream_owner_thread};

/// Maximum number of reads in the queue: more than eight seconds of a device that sends 1000 times per second.
const MAX_QUEUED_READS: usize = 8192;

/// Data from the stream.
#[derive(Debug, Clone)]
pub enum StreamRead {
    /// Bytes of one read, and the time of the read.
    Bytes(Instant, Arc<[u8]>),
    /// Queue overflow: older bytes were dropped unread.
    Overflow,
}

/// Bytes and the time of the read, or the reason why the stream has ended.
type ReadResult = Result<(Instant, Arc<[u8]>), String>;

/// Handle of a stream: receives and sends bytes.
pub struct ByteStreamHandle {
    stream: Arc<SharedStream>,
    /// Reads that this handle has not yet received; a reason for the loss is the last entry.
    incoming: broadcast::Receiver<ReadResult>,
    /// Reason for the loss, once this handle has read it from the queue.
    loss_reason: Option<String>,
}

/// State that all handles of one stream share.
pub(super) struct SharedStream {
    name: String,
    /// Weak: only the owning task keeps the queue open. A further handle subscribes through this sender.
    read_sender: broadcast::WeakSender<ReadResult>,
    outgoing: mpsc::UnboundedSender<Vec<u8>>,
    /// Requests to pass all bytes that have already arrived to the readers; the owning task notifies the sender then.
    drain_requests: mpsc::UnboundedSender<oneshot::Sender<()>>,
    request_turn: Arc<Mutex<RequestTurn>>,
}

/// State behind the lock that a handle holds from its request to the reply: one request at a time on a stream.
#[derive(Default)]
pub struct RequestTurn {
    /// Whether the late reply to an earlier request may still arrive.
    pub is_late_reply_pending: bool,
}

impl ByteStreamHandle {
    /// Wraps a stream inside this process; a task of the caller's runtime owns the stream.
    pub fn from_stream(name: impl Into<String>, stream: impl AsyncRead + AsyncWrite + Send + 'static) -> Self {
        let (handle, channels) = Self::create_channels(name.into());
        tokio::spawn(StreamOwner::new(stream, channels).run());
        handle
    }

    /// Starts the owning thread, which opens the stream.
    pub(super) async fn open(
        name: String,
        open: impl Future<Output = Result<BoxedStream, LinkError>> + Send + 'static,
    ) -> Result<Self, LinkError> {
        let (handle, channels) = Self::create_channels(name);
        start_stream_owner_thread(&handle.stream.name, channels, open).await?;
        Ok(handle)
    }

    fn create_channels(name: String) -> (Self, OwnerChannels<ReadSink>) {
        let (reads, incoming) = broadcast::channel(MAX_QUEUED_READS);
        let (outgoing, queued) = mpsc::unbounded_channel();
        // No urgent queue is needed: no motion depends on a sensor's stream.
        let (_, urgent_queue) = mpsc::unbounded_channel();
        let (drain_requests, drain_queue) = mpsc::unbounded_channel();
        let (reads_weak, request_turn) = (reads.downgrade(), Arc::default());
        let stream = Arc::new(SharedStream { name, read_sender: reads_weak, outgoing, drain_requests, request_turn });
        let handle = Self { stream, incoming, loss_reason: None };
        (handle, OwnerChannels { sink: ReadSink(reads), outgoing: queued, urgent_queue, drain_requests: drain_queue })
    }

    /// Returns one more handle, which receives the bytes from now on; `None` if the stream is lost.
    pub(super) fn from_open_stream(stream: Arc<SharedStream>) -> Option<Self> {
        let incoming = stream.read_sender.upgrade()?.subscribe();
        Some(Self { stream, incoming, loss_reason: None })
    }

    /// Returns a reference that does not keep the stream open.
    pub(super) fn weak_stream(&self) -> Weak<SharedStream> {
        Arc::downgrade(&self.stream)
    }

    /// Lock that all handles of the stream share: held from a request to its reply.
    pub fn request_turn(&self) -> Arc<Mutex<RequestTurn>> {
        self.stream.request_turn.clone()
    }

    /// Queues bytes. They are written completely and in order.
    ///
    /// # Errors
    /// The link is lost.
    pub fn send(&self, bytes: &[u8]) -> Result<(), LinkError> {
        self.stream.outgoing.send(bytes.to_vec()).map_err(|_| self.lost_error())
    }

    /// Drops all bytes that have arrived but that this handle has not read, including bytes in the kernel's buffer;
    /// other handles keep them. (Bytes that an adapter holds back for its next packet are not visible.)
    ///
    /// # Errors
    /// The link is lost.
    pub async fn discard_received(&mut self) -> Result<(), LinkError> {
        let (notify, drained) = oneshot::channel();
        if self.stream.drain_requests.send(notify).is_ok() {
            // If the owning task ends meanwhile, `is_closed` below detects the loss.
            let _ = drained.await;
        }
        // The reason for the loss is the last entry of the queue: read it before the queue is dropped.
        if self.incoming.is_closed() {
            while let Ok(read) = self.incoming.try_recv() {
                self.loss_reason = read.err().or(self.loss_reason.take());
            }
            return Err(self.lost_error());
        }
        self.incoming = self.incoming.resubscribe();
        Ok(())
    }

    /// Next data, or `None` after `deadline`. A lost link stays lost.
    ///
    /// # Errors
    /// The link is lost.
    pub async fn recv_deadline(&mut self, deadline: Instant) -> Result<Option<StreamRead>, LinkError> {
        // Dropping this future at the deadline loses no data: it waits on a channel, not on the device.
        match timeout_at(deadline, self.incoming.recv()).await {
            Err(_) => Ok(None),
            Ok(Ok(Ok((at, bytes)))) => Ok(Some(StreamRead::Bytes(at, bytes))),
            Ok(Ok(Err(why))) => {
                self.loss_reason = Some(why);
                Err(self.lost_error())
            }
            Ok(Err(RecvError::Lagged(_))) => Ok(Some(StreamRead::Overflow)),
            Ok(Err(RecvError::Closed)) => Err(self.lost_error()),
        }
    }

    fn lost_error(&self) -> LinkError {
        let why = self.loss_reason.clone().unwrap_or_else(|| "the link is closed".to_owned());
        LinkError::Lost { address: self.stream.name.clone(), why }
    }
}

/// Sends each read with its time to all handles.
struct ReadSink(broadcast::Sender<ReadResult>);

impl ByteSink for ReadSink {
    fn accept_bytes(&mut self, bytes: &[u8]) -> io::Result<()> {
        // A send error means that no receiver is left, which `wait_for_no_readers` detects.
        let _ = self.0.send(Ok((Instant::now(), bytes.into())));
        Ok(())
    }

    async fn wait_for_no_readers(&self) {
        self.0.closed().await;
    }

    async fn report_loss(self, why: String) {
        let _ = self.0.send(Err(why));
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use tokio::io::AsyncWriteExt;

    use super::*;

    async fn next_bytes(flow: &mut ByteStreamHandle) -> Option<Vec<u8>> {
        match flow.recv_deadline(Instant::now() + Duration::from_secs(5)).await.unwrap() {
            Some(StreamRead::Bytes(_, bytes)) => Some(bytes.to_vec()),
            _ => None,
        }
    }

    #[tokio::test]
    async fn queue_overflow_is_reported_and_discarded_bytes_are_not_read() {
        let (near, mut far) = tokio::io::duplex(64);
        let mut flow = ByteStreamHandle::from_stream("a sensor", near);
        for _ in 0..MAX_QUEUED_READS + 10 {
            far.write_all(b"old").await.unwrap();
            tokio::task::yield_now().await;
        }
        // `None` reports that bytes are missing.
        assert_eq!(next_bytes(&mut flow).await, None);
        assert_eq!(next_bytes(&mut flow).await.unwrap(), b"old");
        flow.discard_received().await.unwrap();
        far.write_all(b"new").await.unwrap();
        assert_eq!(next_bytes(&mut flow).await.unwrap(), b"new");
    }

    /// The owner has not run since these bytes arrived: they are still in the duplex buffer, which stands in for the
    /// kernel's.
    #[tokio::test]
    async fn discard_received_drops_unread_bytes() {
        let (near, mut far) = tokio::io::duplex(1 << 16);
        let mut flow = ByteStreamHandle::from_stream("a sensor", near);
        far.write_all(&[7; 20_000]).await.unwrap();
        flow.discard_received().await.unwrap();
        far.write_all(b"new").await.unwrap();
        assert_eq!(next_bytes(&mut flow).await.unwrap(), b"new");
    }

    #[tokio::test]
    async fn discarding_from_a_lost_stream_returns_the_reason_of_the_loss() {
        let (near, mut far) = tokio::io::duplex(64);
        let mut flow = ByteStreamHandle::from_stream("a sensor", near);
        far.write_all(b"last words").await.unwrap();
        drop(far);
        flow.stream.outgoing.closed().await;
        let error = flow.discard_received().await.unwrap_err();
        assert!(error.to_string().contains("the device closed the connection"), "{error}");
    }
}
