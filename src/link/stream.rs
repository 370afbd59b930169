//! Link with lines in and bytes out; urgent bytes overtake all queued bytes.

use std::future::Future;
use std::io;

use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::mpsc::error::{TryRecvError, TrySendError};
use tokio::sync::{mpsc, oneshot};
use tokio::time::{Instant, timeout_at};

use super::LinkError;
use super::capture::LinkProtocol;
use super::lines::{Assembler, Received};
use super::owner::{Ends, Sink, UrgentMessage, start};
use super::wiring::Wiring;

/// Maximum number of lines in the queue to the reader. A peer that sends more is the wrong device.
const WAITING_LINES: usize = 4096;

/// Handle of a link: receives lines, sends bytes.
pub struct Link {
    name: String,
    incoming: mpsc::Receiver<Result<Received, String>>,
    outgoing: mpsc::UnboundedSender<Vec<u8>>,
    urgent: Urgent,
    lost: Option<String>,
}

/// Sends ahead of everything that is queued, from any thread, without blocking. It never splits a message whose
/// first byte is already written. On a lost link it sends nothing and reports nothing: the reader gets the error.
#[derive(Clone)]
pub struct Urgent(mpsc::UnboundedSender<UrgentMessage>);

impl Urgent {
    pub fn send(&self, bytes: &[u8]) {
        let _ = self.0.send(UrgentMessage { bytes: bytes.to_vec(), last: false });
    }

    /// Like `send`; in addition, everything that [`Link::send`] has queued or will queue is dropped: after a hold,
    /// only urgent bytes follow.
    pub fn send_and_close(&self, bytes: &[u8]) {
        let _ = self.0.send(UrgentMessage { bytes: bytes.to_vec(), last: true });
    }
}

impl Link {
    /// Starts the owning thread for `stream`; `name` is the name in error messages. A stream that belongs to a
    /// runtime's reactor must be opened by [`Link::opened`].
    pub fn over(
        name: impl Into<String>,
        stream: impl AsyncRead + AsyncWrite + Send + 'static,
    ) -> Self {
        let (link, ends) = Self::ends(name.into());
        let (opened, _) = oneshot::channel();
        let wired = Wiring::current().of(&link.name, LinkProtocol::Lines);
        // Without a thread, the ends are dropped, and the link is lost from the start.
        let _ = start(ends, async move { wired.open(async { Ok(stream) }).await }, opened);
        link
    }

    /// Starts the owning thread, which opens its stream.
    pub(super) async fn opened<S: AsyncRead + AsyncWrite + Send + 'static>(
        name: String,
        open: impl Future<Output = Result<S, LinkError>> + Send + 'static,
    ) -> Result<Self, LinkError> {
        let (link, ends) = Self::ends(name);
        let (opened, result) = oneshot::channel();
        let fault = |source| LinkError::Open { address: link.name.clone(), source };
        let wired = Wiring::current().of(&link.name, LinkProtocol::Lines);
        start(ends, async move { wired.open(open).await }, opened).map_err(fault)?;
        result.await.map_err(|_| fault(io::Error::other("its thread has ended")))??;
        Ok(link)
    }

    fn ends(name: String) -> (Self, Ends<Lines>) {
        let (lines, incoming) = mpsc::channel(WAITING_LINES);
        let (outgoing, queued) = mpsc::unbounded_channel();
        let (urgent, urgent_queue) = mpsc::unbounded_channel();
        let link = Self { name, incoming, outgoing, urgent: Urgent(urgent), lost: None };
        let sink = Lines { assembler: Assembler::default(), lines };
        // A link of lines is never emptied on request.
        let (_, emptied) = mpsc::unbounded_channel();
        (link, Ends { sink, queued, urgent_queue, emptied })
    }

    /// Queues one message. It is written completely and in order.
    pub fn send(&self, bytes: &[u8]) -> Result<(), LinkError> {
        self.outgoing.send(bytes.to_vec()).map_err(|_| self.gone())
    }

    /// Queues `line` and a line feed.
    pub fn send_line(&self, line: &str) -> Result<(), LinkError> {
        self.send(format!("{line}\n").as_bytes())
    }

    pub fn urgent(&self) -> Urgent {
        self.urgent.clone()
    }

    /// Next line, or noise. A lost link stays lost.
    pub async fn recv(&mut self) -> Result<Received, LinkError> {
        match self.incoming.recv().await {
            Some(Ok(received)) => Ok(received),
            Some(Err(why)) => {
                self.lost = Some(why);
                Err(self.gone())
            }
            None => Err(self.gone()),
        }
    }

    /// Next line that has already arrived, without waiting; `None` if there is none. (A deadline of now is rounded
    /// up to the timer's next millisecond.)
    pub fn received(&mut self) -> Result<Option<Received>, LinkError> {
        match self.incoming.try_recv() {
            Ok(Ok(received)) => Ok(Some(received)),
            Err(TryRecvError::Empty) => Ok(None),
            Ok(Err(why)) => {
                self.lost = Some(why);
                Err(self.gone())
            }
            Err(TryRecvError::Disconnected) => Err(self.gone()),
        }
    }

    /// Next line, or `None` after `deadline` without a line.
    pub async fn recv_deadline(
        &mut self,
        deadline: Instant,
    ) -> Result<Option<Received>, LinkError> {
        // The dropped future waits on a channel, not on the device.
        timeout_at(deadline, self.recv()).await.ok().transpose()
    }

    fn gone(&self) -> LinkError {
        let why = self.lost.clone().unwrap_or_else(|| "it was closed".to_owned());
        LinkError::Lost { address: self.name.clone(), why }
    }
}

/// Sink that assembles lines.
struct Lines {
    assembler: Assembler,
    lines: mpsc::Sender<Result<Received, String>>,
}

impl Sink for Lines {
    fn take(&mut self, bytes: &[u8]) -> io::Result<()> {
        for item in self.assembler.take(bytes) {
            match self.lines.try_send(Ok(item)) {
                Err(TrySendError::Full(_)) => {
                    return Err(io::Error::other("the other side floods it with lines"));
                }
                Ok(()) | Err(TrySendError::Closed(_)) => {}
            }
        }
        Ok(())
    }

    async fn unwanted(&self) {
        self.lines.closed().await;
    }

    async fn lost(self, why: String) {
        let _ = self.lines.send(Err(why)).await;
    }
}
