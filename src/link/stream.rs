//! A byte stream and the one task that owns it, on a thread of its own: whatever computes or waits
//! elsewhere, an urgent byte goes out. The handles are channels: a dropped or timed-out wait never
//! drops an IO operation half-way.

use std::collections::VecDeque;
use std::future::Future;
use std::io;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadHalf, WriteHalf};
use tokio::sync::mpsc::error::TryRecvError;
use tokio::sync::{mpsc, oneshot};
use tokio::time::{Instant, timeout, timeout_at};

use super::LinkError;
use super::capture::Speech;
use super::lines::{Assembler, Received};
use super::wiring::Wiring;

/// Lines that may wait for their reader. A peer that floods more is the wrong peer.
const WAITING_LINES: usize = 4096;
/// How long the last words may take once the handle is gone.
const LAST_WORDS: Duration = Duration::from_secs(1);

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

struct Ahead {
    bytes: Vec<u8>,
    last: bool,
}

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

    fn ends(name: String) -> (Self, Ends) {
        let (lines, incoming) = mpsc::channel(WAITING_LINES);
        let (outgoing, queued) = mpsc::unbounded_channel();
        let (urgent, urgent_queue) = mpsc::unbounded_channel();
        let link = Self { name, incoming, outgoing, urgent: Urgent(urgent), lost: None };
        (link, Ends { lines, queued, urgent_queue })
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

/// The other ends of the handles' channels.
struct Ends {
    lines: mpsc::Sender<Result<Received, String>>,
    queued: mpsc::UnboundedReceiver<Vec<u8>>,
    urgent_queue: mpsc::UnboundedReceiver<Ahead>,
}

/// A thread that opens a stream, says whether it could, and owns it to the end.
fn start<S: AsyncRead + AsyncWrite + Send + 'static>(
    ends: Ends,
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

/// What the task owns.
struct Owner<S> {
    reader: ReadHalf<S>,
    writer: WriteHalf<S>,
    ends: Ends,
    /// After a hold nothing but urgent bytes goes out.
    closed: bool,
    /// Messages to be written; of the first, some bytes may be gone already.
    pending: VecDeque<Message>,
}

struct Message {
    bytes: Vec<u8>,
    written: usize,
    urgent: bool,
}

impl<S: AsyncRead + AsyncWrite> Owner<S> {
    fn new(stream: S, ends: Ends) -> Self {
        let (reader, writer) = tokio::io::split(stream);
        Self { reader, writer, ends, closed: false, pending: VecDeque::new() }
    }

    async fn run(mut self) {
        let end = self.pump().await;
        let why = match end {
            Ok(()) => {
                self.say_last_words().await;
                return;
            }
            Err(error) => error.to_string(),
        };
        let _ = self.ends.lines.send(Err(why)).await;
    }

    /// Read and write until the handle is dropped (`Ok`) or the link is lost.
    async fn pump(&mut self) -> io::Result<()> {
        let mut assembler = Assembler::default();
        let mut buffer = [0; 4096];
        loop {
            // `read`, `write` and `recv` are cancel safe: a branch not taken has moved no byte.
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
                // The peer may have stopped reading: then the queue never comes to its end.
                () = self.ends.lines.closed() => return Ok(()),
                read = self.reader.read(&mut buffer) => {
                    let count = read?;
                    if count == 0 {
                        return Err(io::Error::other("the other side closed it"));
                    }
                    self.pass_on(assembler.take(&buffer[..count]))?;
                }
            }
        }
    }

    /// Behind a message that has begun and earlier urgent ones, ahead of all others.
    fn put_ahead(&mut self, ahead: Ahead) {
        let goes_first = |message: &&Message| message.urgent || message.written > 0;
        let place = self.pending.iter().take_while(goes_first).count();
        if ahead.last {
            self.closed = true;
            self.pending.truncate(place);
        }
        self.pending.insert(place, Message { bytes: ahead.bytes, written: 0, urgent: true });
    }

    fn pass_on(&self, received: Vec<Received>) -> io::Result<()> {
        for item in received {
            match self.ends.lines.try_send(Ok(item)) {
                Err(mpsc::error::TrySendError::Full(_)) => {
                    return Err(io::Error::other("the other side floods it with lines"));
                }
                Ok(()) | Err(mpsc::error::TrySendError::Closed(_)) => {}
            }
        }
        Ok(())
    }

    /// A hold that was asked for in the last moment still goes out.
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
        let _ = timeout(LAST_WORDS, write).await;
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
