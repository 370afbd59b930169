//! Link that receives lines and sends bytes; urgent bytes overtake all queued bytes.

use std::future::Future;
use std::io;

use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::{TryRecvError, TrySendError};
use tokio::time::{Instant, timeout_at};

use super::LinkError;
use super::boxed_stream::BoxedStream;
use super::line_assembler::{LineAssembler, LineEvent};
use super::stream_owner::{ByteSink, OwnerChannels, UrgentMessage, start_stream_owner_thread};

/// Maximum number of received lines that wait to be read. One more ends the link with an error: a device that sends
/// so much is the wrong device.
const MAX_QUEUED_LINES: usize = 4096;

/// Handle of a link: receives lines, sends bytes.
pub struct LineLink {
    name: String,
    /// Received lines and noise, in order; a reason for the loss is the last entry.
    incoming: mpsc::Receiver<Result<LineEvent, String>>,
    outgoing: mpsc::UnboundedSender<Vec<u8>>,
    urgent: UrgentSender,
    /// Reason for the loss, once this handle has read it from the queue.
    loss_reason: Option<String>,
}

/// Sends ahead of everything that is queued except earlier urgent messages, from any thread, without blocking. A
/// message whose first byte is already written is completed first. On a lost link nothing is sent or reported: the
/// receiver of the lines gets the error.
#[derive(Clone)]
pub struct UrgentSender(mpsc::UnboundedSender<UrgentMessage>);

impl UrgentSender {
    pub fn send(&self, bytes: &[u8]) {
        let _ = self.0.send(UrgentMessage { bytes: bytes.to_vec(), drops_non_urgent: false });
    }

    /// Like `send`; in addition, everything that [`LineLink::send`] has queued or will queue is dropped: after a hold,
    /// only urgent bytes follow.
    pub fn send_and_drop_non_urgent(&self, bytes: &[u8]) {
        let _ = self.0.send(UrgentMessage { bytes: bytes.to_vec(), drops_non_urgent: true });
    }
}

impl LineLink {
    /// Starts the owning thread for `stream`; `name` is the name in error messages. A stream that belongs to a
    /// runtime's reactor must be opened by [`LineLink::open`].
    pub fn from_stream(name: impl Into<String>, stream: impl AsyncRead + AsyncWrite + Send + 'static) -> Self {
        let (link, channels) = Self::create_channels(name.into());
        let stream: BoxedStream = Box::pin(stream);
        // If the thread cannot be started, the receiving ends are dropped, and the link is lost from the start.
        drop(start_stream_owner_thread(&link.name, channels, async { Ok(stream) }));
        link
    }

    /// Starts the owning thread, which opens its stream.
    pub(super) async fn open(
        name: String,
        open: impl Future<Output = Result<BoxedStream, LinkError>> + Send + 'static,
    ) -> Result<Self, LinkError> {
        let (link, channels) = Self::create_channels(name);
        start_stream_owner_thread(&link.name, channels, open).await?;
        Ok(link)
    }

    fn create_channels(name: String) -> (Self, OwnerChannels<LineSink>) {
        let (lines, incoming) = mpsc::channel(MAX_QUEUED_LINES);
        let (outgoing, queued) = mpsc::unbounded_channel();
        let (urgent, urgent_queue) = mpsc::unbounded_channel();
        let link = Self { name, incoming, outgoing, urgent: UrgentSender(urgent), loss_reason: None };
        let sink = LineSink { assembler: LineAssembler::default(), line_sender: lines };
        // A link of lines is never drained on request.
        let (_, drain_requests) = mpsc::unbounded_channel();
        (link, OwnerChannels { sink, outgoing: queued, urgent_queue, drain_requests })
    }

    /// Queues one message. It is written completely and in order, or dropped as a whole by
    /// `UrgentSender::send_and_drop_non_urgent`.
    pub fn send(&self, bytes: &[u8]) -> Result<(), LinkError> {
        self.outgoing.send(bytes.to_vec()).map_err(|_| self.lost_error())
    }

    /// Queues `line` and a line feed.
    pub fn send_line(&self, line: &str) -> Result<(), LinkError> {
        self.send(format!("{line}\n").as_bytes())
    }

    pub fn urgent_sender(&self) -> UrgentSender {
        self.urgent.clone()
    }

    /// Next line, or noise. A lost link stays lost.
    pub async fn recv(&mut self) -> Result<LineEvent, LinkError> {
        let received = self.incoming.recv().await;
        self.event_or_loss(received)
    }

    /// Next line that has already arrived, without waiting; `None` if there is none. (`recv_deadline` with a deadline
    /// of now would wait up to 1 ms, the resolution of the timer.)
    pub fn try_recv(&mut self) -> Result<Option<LineEvent>, LinkError> {
        match self.incoming.try_recv() {
            Err(TryRecvError::Empty) => Ok(None),
            received => self.event_or_loss(received.ok()).map(Some),
        }
    }

    /// Returns the line of a queue entry; `None` is the end of the queue.
    fn event_or_loss(&mut self, received: Option<Result<LineEvent, String>>) -> Result<LineEvent, LinkError> {
        match received {
            Some(Ok(event)) => return Ok(event),
            Some(Err(why)) => self.loss_reason = Some(why),
            None => {}
        }
        Err(self.lost_error())
    }

    /// Next line, or `None` after `deadline` without a line.
    pub async fn recv_deadline(&mut self, deadline: Instant) -> Result<Option<LineEvent>, LinkError> {
        // Dropping this future at the deadline loses no line: it waits on a channel, not on the device.
        timeout_at(deadline, self.recv()).await.ok().transpose()
    }

    fn lost_error(&self) -> LinkError {
        let why = self.loss_reason.clone().unwrap_or_else(|| "the link is closed".to_owned());
        LinkError::Lost { address: self.name.clone(), why }
    }
}

/// Sink that assembles lines. A full queue is an error, which ends the link.
struct LineSink {
    assembler: LineAssembler,
    line_sender: mpsc::Sender<Result<LineEvent, String>>,
}

impl ByteSink for LineSink {
    fn accept_bytes(&mut self, bytes: &[u8]) -> io::Result<()> {
        for item in self.assembler.push(bytes) {
            match self.line_sender.try_send(Ok(item)) {
                Err(TrySendError::Full(_)) => {
                    return Err(io::Error::other("the device sends lines faster than they are read"));
                }
                Ok(()) | Err(TrySendError::Closed(_)) => {}
            }
        }
        Ok(())
    }

    async fn wait_for_no_readers(&self) {
        self.line_sender.closed().await;
    }

    async fn report_loss(self, why: String) {
        let _ = self.line_sender.send(Err(why)).await;
    }
}
