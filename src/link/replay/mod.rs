//! Replay of a capture instead of a machine: each command gets the captured reply.
//!
//! Replies are matched by command, not by time. Commands must have the captured order; an unknown command ends the
//! link with a message that contains it. Queries (a status report, a line that begins with `get `, a Modbus read,
//! reading a file) may be more or less frequent than in the capture: the reply comes from the data between the same
//! two commands, and after that data is used up, the last reply of its kind is repeated.

use std::collections::VecDeque;
use std::fmt;
use std::io;
use std::path::Path;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Waker};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

mod files;
mod frames;
mod lines;
mod read;
mod registers;
#[cfg(test)]
mod tests;

use super::capture::LinkProtocol;
use crate::Clock;
use read::Track;

/// Error: a capture cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    #[error("{file}: {source}")]
    File { file: String, source: io::Error },
    #[error("{file}, line {line}: {why}: this is no capture, or it was cut or changed")]
    Undecodable { file: String, line: usize, why: String },
}

/// Captured data of a device, and its time.
#[derive(Debug, Clone, PartialEq)]
struct Said {
    at_s: f64,
    bytes: Vec<u8>,
}

/// Replay of one link: takes sent bytes, returns the captured replies.
trait Script: Send {
    /// # Errors
    /// The command that is not in the capture; as a message.
    fn hear(&mut self, bytes: &[u8]) -> Result<Vec<Said>, String>;
}

/// All links of a capture.
#[derive(Clone)]
pub struct Replay {
    tracks: Arc<Mutex<Vec<Track>>>,
    now_s: Arc<Mutex<f64>>,
}

impl Replay {
    /// # Errors
    /// See [`CaptureError`]; it contains the line number.
    pub fn read(path: &Path) -> Result<Self, CaptureError> {
        let file = path.display().to_string();
        let text = std::fs::read_to_string(path)
            .map_err(|source| CaptureError::File { file: file.clone(), source })?;
        let tracks = read::tracks(&text).map_err(|(line, why)| CaptureError::Undecodable {
            file,
            line,
            why,
        })?;
        Ok(Self { tracks: Arc::new(Mutex::new(tracks)), now_s: Arc::default() })
    }

    /// Clock that runs with the times of the capture.
    pub fn clock(&self) -> Arc<dyn Clock> {
        Arc::new(self.clone())
    }

    /// Next link of this name. Names may have changed since the capture: without a match, the next link of the same
    /// protocol.
    pub(super) fn player(&self, name: &str, speech: LinkProtocol) -> Player {
        let mut tracks = locked(&self.tracks);
        let speaks = |track: &Track| track.speech == speech;
        let named = tracks.iter().position(|track| speaks(track) && track.name == name);
        let index = named.or_else(|| tracks.iter().position(speaks));
        let playing = match index.map(|index| tracks.remove(index)) {
            Some(track) => Playing { script: Some(script(&track)), ..Playing::default() },
            None => Playing {
                failed: Some(format!("the capture holds no (other) link like {name}")),
                ..Playing::default()
            },
        };
        let player = Player { now_s: self.now_s.clone(), playing: Arc::new(Mutex::new(playing)) };
        // Data that the device sends without a request.
        player.hear(&[]);
        player
    }
}

impl Clock for Replay {
    fn now_s(&self) -> f64 {
        *locked(&self.now_s)
    }
}

fn script(track: &Track) -> Box<dyn Script> {
    match track.speech {
        LinkProtocol::Lines | LinkProtocol::Samples => Box::new(lines::Lines::new(track)),
        LinkProtocol::ModbusRtu => Box::new(registers::Registers::new(track, frames::Frames::Rtu)),
        LinkProtocol::ModbusTcp => Box::new(registers::Registers::new(track, frames::Frames::Tcp)),
        LinkProtocol::Files => Box::new(files::Files::new(track)),
    }
}

fn locked<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Replay of one link of a capture; the link may be opened more than once.
#[derive(Clone)]
pub(super) struct Player {
    now_s: Arc<Mutex<f64>>,
    playing: Arc<Mutex<Playing>>,
}

#[derive(Default)]
struct Playing {
    script: Option<Box<dyn Script>>,
    coming: VecDeque<u8>,
    failed: Option<String>,
    reader: Option<Waker>,
}

impl Player {
    pub(super) fn stream(&self) -> impl AsyncRead + AsyncWrite + Send + use<> {
        Played(self.clone())
    }

    /// Passes sent bytes to the replay, and returns all replies.
    ///
    /// # Errors
    /// The command is not in the capture.
    pub(super) fn ask(&self, bytes: &[u8]) -> io::Result<Vec<u8>> {
        self.hear(bytes);
        let mut playing = locked(&self.playing);
        match &playing.failed {
            Some(why) => Err(io::Error::other(why.clone())),
            None => Ok(playing.coming.drain(..).collect()),
        }
    }

    /// Passes sent bytes to the replay.
    pub(super) fn hear(&self, bytes: &[u8]) {
        let mut playing = locked(&self.playing);
        let heard = match &mut playing.script {
            Some(script) => script.hear(bytes),
            None => return,
        };
        match heard {
            Ok(said) => {
                for Said { at_s, bytes } in said {
                    let mut now_s = locked(&self.now_s);
                    *now_s = now_s.max(at_s);
                    playing.coming.extend(bytes);
                }
            }
            Err(why) => (playing.failed, playing.script) = (Some(why), None),
        }
        if let Some(reader) = playing.reader.take() {
            reader.wake();
        }
    }
}

struct Played(Player);

impl AsyncRead for Played {
    fn poll_read(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let mut playing = locked(&self.0.playing);
        if playing.coming.is_empty() {
            if let Some(why) = &playing.failed {
                return Poll::Ready(Err(io::Error::other(why.clone())));
            }
            playing.reader = Some(context.waker().clone());
            return Poll::Pending;
        }
        let count = playing.coming.len().min(buffer.remaining());
        let bytes: Vec<u8> = playing.coming.drain(..count).collect();
        buffer.put_slice(&bytes);
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Played {
    fn poll_write(
        self: Pin<&mut Self>,
        _: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        self.0.hear(bytes);
        Poll::Ready(Ok(bytes.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

impl fmt::Debug for Replay {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Replay")
    }
}
