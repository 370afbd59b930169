//! Every byte of every link with its time, in a file.
//!
//! ```text
//! # trued-capture 1
//! 0.000113 1 = lines 127.0.0.1:5007
//! 0.000406 1 > $I\n
//! 0.002195 1 < [AXS:5:XYZBC]\r\nok\r\n
//! ```
//!
//! A line is: seconds since the beginning, the link's number, a mark, the rest. `=` opens the link (once
//! more after it was lost): how it speaks (`lines`, `modbus-rtu`, `modbus-tcp`, `files`, `samples`) and its name; `>` is
//! what was sent, `<` what came, with `\n`, `\r`, `\t`, `\\`, `\'`, `\"` and `\xNN` for what is not printable.
//! Of shared files each is a file's name and, behind a line feed, its text; a name alone is one that is not
//! there. What is read stands there when it has changed. Of a sensor it is what was asked of it and the samples
//! that it gave, whatever it speaks: frames and bytes that come unasked fit no command, and could not be
//! replayed. Lines that begin with `#` are comments.

use std::fmt;
use std::fs::File;
use std::io::{self, Write as _};
use std::path::Path;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::Instant;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

pub(super) const HEAD: &str = "# trued-capture 1";

/// How the bytes of a link are to be understood.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Speech {
    Lines,
    ModbusRtu,
    ModbusTcp,
    Files,
    Samples,
}

impl Speech {
    pub(super) const ALL: [Self; 5] =
        [Self::Lines, Self::ModbusRtu, Self::ModbusTcp, Self::Files, Self::Samples];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Lines => "lines",
            Self::ModbusRtu => "modbus-rtu",
            Self::ModbusTcp => "modbus-tcp",
            Self::Files => "files",
            Self::Samples => "samples",
        }
    }
}

/// The file that is written.
#[derive(Clone)]
pub struct Capture {
    begun: Instant,
    out: Arc<Mutex<Out>>,
}

struct Out {
    file: File,
    links: u32,
    failed: Option<io::Error>,
}

impl Capture {
    /// Begin a new file.
    ///
    /// # Errors
    /// It is there already, or cannot be made.
    pub fn create(path: &Path) -> io::Result<Self> {
        let mut file = File::create_new(path)?;
        if let Err(error) = writeln!(file, "{HEAD}") {
            // An empty file would stand in the way of the next one.
            let _ = std::fs::remove_file(path);
            return Err(error);
        }
        let out = Arc::new(Mutex::new(Out { file, links: 0, failed: None }));
        Ok(Self { begun: Instant::now(), out })
    }

    /// Whether everything is in the file: a run goes on without it.
    ///
    /// # Errors
    /// The first fault met.
    pub fn finish(&self) -> io::Result<()> {
        let mut out = self.out.lock().unwrap_or_else(PoisonError::into_inner);
        out.failed.take().map_or_else(|| out.file.sync_all(), Err)
    }

    pub(super) fn tap(&self, name: &str, speech: Speech) -> Tap {
        let mut out = self.out.lock().unwrap_or_else(PoisonError::into_inner);
        out.links += 1;
        let opening = format!("{} {name}", speech.name());
        Tap { capture: self.clone(), link: out.links, opening }
    }

    fn write(&self, link: u32, mark: char, text: impl fmt::Display) {
        let mut out = self.out.lock().unwrap_or_else(PoisonError::into_inner);
        if out.failed.is_some() {
            return;
        }
        // With the lock held: lines stand in the order of their times.
        let seconds = self.begun.elapsed().as_secs_f64();
        let line = format!("{seconds:.6} {link} {mark} {text}\n");
        // One write a line: a crash leaves whole lines.
        out.failed = out.file.write_all(line.as_bytes()).err();
    }
}

/// One link's place in a capture.
#[derive(Clone)]
pub(super) struct Tap {
    capture: Capture,
    link: u32,
    opening: String,
}

impl Tap {
    /// `stream`, listened to.
    pub(super) fn on<S: AsyncRead + AsyncWrite>(&self, stream: S) -> Tapped<S> {
        self.opened();
        Tapped { stream: Box::pin(stream), tap: self.clone() }
    }

    pub(super) fn opened(&self) {
        self.capture.write(self.link, '=', &self.opening);
    }

    pub(super) fn note(&self, mark: char, bytes: &[u8]) {
        if !bytes.is_empty() {
            self.capture.write(self.link, mark, bytes.escape_ascii());
        }
    }
}

pub(super) struct Tapped<S> {
    stream: Pin<Box<S>>,
    tap: Tap,
}

impl<S: AsyncRead> AsyncRead for Tapped<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        ready!(self.stream.as_mut().poll_read(context, buffer))?;
        self.tap.note('<', buffer.filled().get(before..).unwrap_or_default());
        Poll::Ready(Ok(()))
    }
}

impl<S: AsyncWrite> AsyncWrite for Tapped<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let count = ready!(self.stream.as_mut().poll_write(context, bytes))?;
        self.tap.note('>', bytes.get(..count).unwrap_or_default());
        Poll::Ready(Ok(count))
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.stream.as_mut().poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.stream.as_mut().poll_shutdown(context)
    }
}
