//! Lines in, bytes out, with an urgent way past all that is queued.

use std::future::Future;
use std::io;

use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::mpsc::error::{TryRecvError, TrySendError};
use tokio::sync::{mpsc, oneshot};
use tokio::time::{Instant, timeout_at};

use super::LinkError;
use super::capture::Speech;
use super::lines::{Assembler, Received};
use super::owner::{Ahead, Ends, Sink, start};
use super::wiring::Wiring;

/// Lines that may wait for their reader. A peer that floods more is the wrong peer.
const WAITING_LINES: usize = 4096;

/// The handle: lines in, bytes out.
pub struct Link {
    name: String,
    incoming: mpsc::Receiver<Result<Received, String>>,
    outgoing: mpsc::UnboundedSender<Vec<u8>>,
    urgent: Urgent,
    lost: Option<String>,
}

/// Sends ahead of everything that is queued, from any thread, without blocking. It never splits a
/// message whose first byte is on its way. On a lost link nothing is sent and nothing is said: the
/// error comes to whoever reads.
#[derive(Clone)]
pub struct Urgent(mpsc::UnboundedSender<Ahead>);

impl Urgent {
    pub fn send(&self, bytes: &[u8]) {
        let _ = self.0.send(Ahead { bytes: bytes.to_vec(), last: false });
    }

    /// As `send`, and whatever [`Link::send`] queued or will queue is thrown away: after a hold,
    /// only urgent bytes follow.
    pub fn send_and_close(&self, bytes: &[u8]) {
        let _ = self.0.send(Ahead { bytes: bytes.to_vec(), last: true });
    }
}

impl Link {
    /// Start the owning thread for `stream`; `name` is how errors call it. A stream that belongs to
    /// a runtime's reactor must be opened by [`Link::opened`].
    pub fn over(
        name: impl Into<String>,
        stream: impl AsyncRead + AsyncWrite + Send + 'static,
    ) -> Self {
        let (link, ends) = Self::ends(name.into());
        let (opened, _) = oneshot::channel();
        let wired = Wiring::current().of(&link.name, Speech::Lines);
        // Without a thread the ends are dropped, and the link is lost from the start.
        let _ = start(ends, async move { wired.open(async { Ok(stream) }).await }, opened);
        link
    }

    /// Start the owning thread and let it open its stream.
    pub(super) async fn opened<S: AsyncRead + AsyncWrite + Send + 'static>(
        name: String,
        open: impl Future<Output = Result<S, LinkError>> + Send + 'static,
    ) -> Result<Self, LinkError> {
        let (link, ends) = Self::ends(name);
        let (opened, result) = oneshot::channel();
        let fault = |source| LinkError::Open { address: link.name.clone(), source };
        let wired = Wiring::current().of(&link.name, Speech::Lines);
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
        // Nobody asks a line to be emptied.
        let (_, emptied) = mpsc::unbounded_channel();
        (link, Ends { sink, queued, urgent_queue, emptied })
    }

    /// Queue one message; it is written whole, in order.
    pub fn send(&self, bytes: &[u8]) -> Result<(), LinkError> {
        self.outgoing.send(bytes.to_vec()).map_err(|_| self.gone())
    }

    /// Queue `line` and a line feed.
    pub fn send_line(&self, line: &str) -> Result<(), LinkError> {
        self.send(format!("{line}\n").as_bytes())
    }

    pub fn urgent(&self) -> Urgent {
        self.urgent.clone()
    }

    /// The next line, or noise. Once lost, a link stays lost.
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

    /// What has come already, without waiting; `None`: nothing. (A deadline of now is rounded up to the
    /// timer's next millisecond.)
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

    /// The next line, or `None` when `deadline` has passed without one.
    pub async fn recv_deadline(
        &mut self,
        deadline: Instant,
    ) -> Result<Option<Received>, LinkError> {
        // What is dropped here waits on a channel, not on the device.
        timeout_at(deadline, self.recv()).await.ok().transpose()
    }

    fn gone(&self) -> LinkError {
        let why = self.lost.clone().unwrap_or_else(|| "it was closed".to_owned());
        LinkError::Lost { address: self.name.clone(), why }
    }
}

/// What comes as lines.
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
