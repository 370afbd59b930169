//! Replay of a capture instead of a machine: each command gets the captured reply.
//!
//! Replies are matched by command, not by time. Commands must have the captured order; an unknown command ends the
//! link with a message that contains it. Queries (a status report, a line that begins with `get `, a Modbus read,
//! reading a file) may be more or less frequent than in the capture: the reply comes from the data between the same
//! two commands, and after that data is used up, the last reply of its kind is repeated.

use std::collections::VecDeque;
use std::io;
use std::path::Path;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Waker};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

mod capture_parser;
mod exchange_history;
mod file_script;
mod line_script;
mod modbus_frames;
mod register_script;
#[cfg(test)]
mod tests;

use super::capture::LinkProtocol;
use crate::Clock;
use capture_parser::CapturedLink;

/// Error: a capture cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    #[error("{file}: {source}")]
    ReadFailed { file: String, source: io::Error },
    #[error("{file}, line {line}: {why}: the file is not a capture, or it was cut or changed")]
    Undecodable { file: String, line: usize, why: String },
}

/// Error: a link deviates from the capture.
#[derive(Debug, Clone, thiserror::Error)]
enum ReplayError {
    #[error("the capture has no further link with the protocol of {link}")]
    NoFurtherLink { link: String },
    #[error("the capture has no {request}")]
    UnknownRequest { request: String },
    #[error("the capture has no {command} at this point; its next command is {next}")]
    UnexpectedCommand { command: String, next: String },
    #[error("the capture has no {write} at this point; its next write is {next}")]
    UnexpectedWrite { write: String, next: String },
    #[error("the text of {file} differs from the capture; captured text: {captured}")]
    DifferentText { file: String, captured: String },
}

/// Captured data of a device, and the time of reception from the start of the capture, s.
#[derive(Debug, Clone, PartialEq)]
struct CapturedReply {
    time_s: f64,
    bytes: Vec<u8>,
}

/// Replay of one link: takes sent bytes, returns the captured replies.
trait LinkScript: Send {
    /// # Errors
    /// A command is not the next one of the capture, or a query has no captured reply.
    fn reply_to(&mut self, bytes: &[u8]) -> Result<Vec<CapturedReply>, ReplayError>;
}

/// All links of a capture.
#[derive(Clone)]
pub struct CaptureReplay {
    /// Links of the capture that no link of the program has taken yet.
    remaining_links: Arc<Mutex<Vec<CapturedLink>>>,
    /// Capture time of the latest reply that any link has returned, s.
    now_s: Arc<Mutex<f64>>,
}

impl CaptureReplay {
    /// # Errors
    /// See [`CaptureError`]; it contains the line number.
    pub fn read(path: &Path) -> Result<Self, CaptureError> {
        let file = path.display().to_string();
        let text =
            std::fs::read_to_string(path).map_err(|source| CaptureError::ReadFailed { file: file.clone(), source })?;
        let links = capture_parser::parse_capture(&file, &text)?;
        Ok(Self { remaining_links: Arc::new(Mutex::new(links)), now_s: Arc::default() })
    }

    /// Clock of the replay: the capture time of the latest reply so far; it stands still between replies.
    pub fn clock(&self) -> Arc<dyn Clock> {
        Arc::new(self.clone())
    }

    /// Takes the next captured link of this protocol and name. Names may have changed since the capture: without a
    /// match, the next link of the same protocol; without any, every use of the link fails.
    pub(super) fn take_link_replay(&self, name: &str, protocol: LinkProtocol) -> LinkReplay {
        let mut links = lock(&self.remaining_links);
        let has_protocol = |link: &CapturedLink| link.protocol == protocol;
        let named = links.iter().position(|link| has_protocol(link) && link.name == name);
        let index = named.or_else(|| links.iter().position(has_protocol));
        let script = index.map(|index| create_script(&links.remove(index)));
        let failure = script.is_none().then(|| ReplayError::NoFurtherLink { link: name.to_owned() });
        let state = ReplayState { script, failure, ..ReplayState::default() };
        let link_replay = LinkReplay { now_s: self.now_s.clone(), state: Arc::new(Mutex::new(state)) };
        // Queues the data that the device has sent before the first request.
        link_replay.process_sent_bytes(&[]);
        link_replay
    }
}

impl Clock for CaptureReplay {
    fn now_s(&self) -> f64 {
        *lock(&self.now_s)
    }
}

fn create_script(captured: &CapturedLink) -> Box<dyn LinkScript> {
    match captured.protocol {
        LinkProtocol::Lines | LinkProtocol::SensorSamples => Box::new(line_script::LineScript::new(captured)),
        LinkProtocol::Modbus(framing) => Box::new(register_script::RegisterScript::new(captured, framing)),
        LinkProtocol::SharedFiles => Box::new(file_script::FileScript::new(captured)),
    }
}

fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Replay of one link of a capture; the link may be opened more than once.
#[derive(Clone)]
pub(super) struct LinkReplay {
    now_s: Arc<Mutex<f64>>,
    state: Arc<Mutex<ReplayState>>,
}

#[derive(Default)]
struct ReplayState {
    /// `None` after a failure.
    script: Option<Box<dyn LinkScript>>,
    /// Replies that are not yet read.
    reply_bytes: VecDeque<u8>,
    /// First deviation from the capture; later reads return it.
    failure: Option<ReplayError>,
    reader_waker: Option<Waker>,
}

impl LinkReplay {
    pub(super) fn stream(&self) -> impl AsyncRead + AsyncWrite + Send + use<> {
        ReplayStream(self.clone())
    }

    /// Passes sent bytes to the replay, and removes and returns all replies that are not yet read.
    ///
    /// # Errors
    /// These or earlier bytes deviate from the capture: the first deviation ends the replay of the link.
    pub(super) fn exchange(&self, bytes: &[u8]) -> io::Result<Vec<u8>> {
        self.process_sent_bytes(bytes);
        let mut state = lock(&self.state);
        match &state.failure {
            Some(error) => Err(io::Error::other(error.clone())),
            None => Ok(state.reply_bytes.drain(..).collect()),
        }
    }

    /// Passes sent bytes to the replay, which stores the replies to be read and moves the clock to their capture
    /// times.
    pub(super) fn process_sent_bytes(&self, bytes: &[u8]) {
        let mut state = lock(&self.state);
        let Some(script) = &mut state.script else { return };
        match script.reply_to(bytes) {
            Ok(replies) => {
                for CapturedReply { time_s, bytes } in replies {
                    let mut now_s = lock(&self.now_s);
                    *now_s = now_s.max(time_s);
                    state.reply_bytes.extend(bytes);
                }
            }
            Err(error) => (state.failure, state.script) = (Some(error), None),
        }
        if let Some(reader_waker) = state.reader_waker.take() {
            reader_waker.wake();
        }
    }
}

struct ReplayStream(LinkReplay);

impl AsyncRead for ReplayStream {
    fn poll_read(self: Pin<&mut Self>, context: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let mut state = lock(&self.0.state);
        if state.reply_bytes.is_empty() {
            if let Some(error) = &state.failure {
                return Poll::Ready(Err(io::Error::other(error.clone())));
            }
            state.reader_waker = Some(context.waker().clone());
            return Poll::Pending;
        }
        let count = state.reply_bytes.len().min(buffer.remaining());
        let bytes: Vec<u8> = state.reply_bytes.drain(..count).collect();
        buffer.put_slice(&bytes);
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for ReplayStream {
    fn poll_write(self: Pin<&mut Self>, _: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        self.0.process_sent_bytes(bytes);
        Poll::Ready(Ok(bytes.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}
