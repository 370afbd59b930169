//! Capture file: every byte of every link, with its time.
//!
//! ```text
//! # trued-capture 1
//! 0.000113 1 = lines 127.0.0.1:5007
//! 0.000406 1 > $I\n
//! 0.002195 1 < [AXS:5:XYZBC]\r\nok\r\n
//! ```
//!
//! Each line holds: seconds since the start, the number of the link, a mark, the content. `=` opens the link (again
//! after a loss): its protocol (`lines`, `modbus-rtu`, `modbus-tcp`, `files`, `samples`) and its name. `>` marks
//! sent bytes, `<` received bytes, with `\n`, `\r`, `\t`, `\\`, `\'`, `\"` and `\xNN` for bytes that are not
//! printable. For shared files, the content is the name of a file and, after a line feed, its text; a name alone
//! means that the file is missing. A read is recorded only if the text has changed. For a sensor, the content is the
//! requests and the returned samples, not the bytes on the wire: frames and bytes that a sensor sends without a
//! request belong to no command, so a replay could not match them. Lines that begin with `#` are comments.

use std::fmt;
use std::fs::File;
use std::io::{self, Write as _};
use std::path::Path;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::Instant;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use super::boxed_stream::BoxedStream;
use super::modbus::Framing;

pub(super) const CAPTURE_HEADER: &str = "# trued-capture 1";

/// Protocol of a link: how the replay must interpret the bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum LinkProtocol {
    /// Bytes of a serial port or TCP connection, matched line by line in a replay.
    Lines,
    Modbus(Framing),
    SharedFiles,
    /// Requests to the driver of a sensor, and the returned samples, as text lines; not the bytes on the wire.
    SensorSamples,
}

impl LinkProtocol {
    pub(super) const ALL: [Self; 5] = [
        Self::Lines,
        Self::Modbus(Framing::Rtu),
        Self::Modbus(Framing::Tcp),
        LinkProtocol::SharedFiles,
        LinkProtocol::SensorSamples,
    ];

    pub(super) fn keyword(self) -> &'static str {
        match self {
            Self::Lines => "lines",
            Self::Modbus(Framing::Rtu) => "modbus-rtu",
            Self::Modbus(Framing::Tcp) => "modbus-tcp",
            LinkProtocol::SharedFiles => "files",
            LinkProtocol::SensorSamples => "samples",
        }
    }
}

/// Capture file that is being written.
#[derive(Clone)]
pub struct CaptureWriter {
    /// Zero of the times in the file.
    start_time: Instant,
    output: Arc<Mutex<CaptureOutput>>,
}

struct CaptureOutput {
    file: File,
    /// Number of links so far; also the number of the newest link in the file. A reopened link keeps its number.
    link_count: u32,
    /// First write error; after it nothing more is written. [`CaptureWriter::finish`] removes and returns it.
    first_error: Option<io::Error>,
}

impl CaptureWriter {
    /// Creates a new file.
    ///
    /// # Errors
    /// The file exists already, or cannot be created.
    pub fn create(path: &Path) -> io::Result<Self> {
        let mut file = File::create_new(path)?;
        if let Err(error) = writeln!(file, "{CAPTURE_HEADER}") {
            // An empty file would make the next attempt fail: `create_new` refuses an existing file.
            let _ = std::fs::remove_file(path);
            return Err(error);
        }
        let out = Arc::new(Mutex::new(CaptureOutput { file, link_count: 0, first_error: None }));
        Ok(Self { start_time: Instant::now(), output: out })
    }

    /// Writes the file to the disk, and checks that all lines were written. A write error does not stop the run; it
    /// is returned here, once.
    ///
    /// # Errors
    /// The first write error.
    pub fn finish(&self) -> io::Result<()> {
        let mut out = self.output.lock().unwrap_or_else(PoisonError::into_inner);
        out.first_error.take().map_or_else(|| out.file.sync_all(), Err)
    }

    /// Gives the next number to a new link. Nothing is written before the link is opened.
    pub(super) fn create_link_recorder(&self, name: &str, protocol: LinkProtocol) -> LinkRecorder {
        let mut out = self.output.lock().unwrap_or_else(PoisonError::into_inner);
        out.link_count += 1;
        let opening_text = format!("{} {name}", protocol.keyword());
        LinkRecorder { capture: self.clone(), link_number: out.link_count, opening_text }
    }

    /// Writes one line with the present time; nothing after a write error.
    fn write_line(&self, link_number: u32, mark: char, text: impl fmt::Display) {
        let mut out = self.output.lock().unwrap_or_else(PoisonError::into_inner);
        if out.first_error.is_some() {
            return;
        }
        // The lock is held, so that the lines are in the order of their times.
        let seconds = self.start_time.elapsed().as_secs_f64();
        let line = format!("{seconds:.6} {link_number} {mark} {text}\n");
        // One write per line: after a crash, all lines are complete.
        out.first_error = out.file.write_all(line.as_bytes()).err();
    }
}

/// Writes what one link sends and receives to the capture file.
#[derive(Clone)]
pub(super) struct LinkRecorder {
    capture: CaptureWriter,
    link_number: u32,
    /// Content of the line `=`: keyword of the protocol and name of the link.
    opening_text: String,
}

impl LinkRecorder {
    /// Records the opening of the link, and wraps `stream` so that its bytes are recorded.
    pub(super) fn wrap_stream(&self, stream: BoxedStream) -> RecordedStream {
        self.record_opening();
        RecordedStream { stream, recorder: self.clone() }
    }

    pub(super) fn record_opening(&self) {
        self.capture.write_line(self.link_number, '=', &self.opening_text);
    }

    /// Writes one line, `mark` being `>` (sent) or `<` (received); nothing for empty `bytes`.
    pub(super) fn record_bytes(&self, mark: char, bytes: &[u8]) {
        if !bytes.is_empty() {
            self.capture.write_line(self.link_number, mark, bytes.escape_ascii());
        }
    }
}

pub(super) struct RecordedStream {
    stream: BoxedStream,
    recorder: LinkRecorder,
}

impl AsyncRead for RecordedStream {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        ready!(self.stream.as_mut().poll_read(context, buffer))?;
        self.recorder.record_bytes('<', buffer.filled().get(before..).unwrap_or_default());
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for RecordedStream {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let count = ready!(self.stream.as_mut().poll_write(context, bytes))?;
        self.recorder.record_bytes('>', bytes.get(..count).unwrap_or_default());
        Poll::Ready(Ok(count))
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.stream.as_mut().poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.stream.as_mut().poll_shutdown(context)
    }
}
