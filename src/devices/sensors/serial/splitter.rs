//! Splits a byte stream into lines or frames, and decodes them. Reads may end anywhere in a line or frame, and the
//! stream may be unreadable.

use super::format::DataFormat;
use super::{frame, line};
use crate::sensors::sample_layout::DecodedSample;

/// Maximum number of bytes that may come without a line end; more are undecodable.
const MAX_LINE_BYTES: usize = 512;

/// A line without its end, or a frame; or bytes that are neither.
#[derive(Debug, PartialEq)]
pub(super) enum StreamPiece {
    Decoded {
        sample: DecodedSample,
        /// Number of bytes of the whole piece, the line end included.
        consumed_byte_count: usize,
    },
    /// Bytes that cannot be decoded.
    Undecodable(Vec<u8>),
}

/// Splits the byte stream of one sensor, and decodes the pieces.
#[derive(Debug)]
pub(super) struct StreamSplitter {
    format: DataFormat,
    /// Received bytes that do not complete a piece yet.
    buffer: Vec<u8>,
    /// Whether the bytes may begin within a line or frame: those before the next start of a line or frame are not
    /// decoded.
    is_unsynchronized: bool,
}

impl StreamSplitter {
    pub fn new(format: DataFormat) -> Self {
        Self { format, buffer: Vec::new(), is_unsynchronized: true }
    }

    /// Discards the bytes in the buffer. `is_within_piece`: the next bytes may begin within a line or frame.
    pub fn discard_buffer(&mut self, is_within_piece: bool) {
        self.buffer.clear();
        self.is_unsynchronized = is_within_piece;
    }

    /// Appends `bytes`, and returns all pieces that they complete, in order.
    pub fn push(&mut self, bytes: &[u8]) -> Vec<StreamPiece> {
        self.buffer.extend_from_slice(bytes);
        match &self.format {
            DataFormat::Line(layout) => split_lines(layout, &mut self.buffer, &mut self.is_unsynchronized),
            DataFormat::Frame(layout) => split_frames(layout, &mut self.buffer, &mut self.is_unsynchronized),
        }
    }
}

/// Takes all whole lines from `buffer`. Empty lines are ignored, and so is the first line if the bytes may begin within
/// a line.
fn split_lines(layout: &line::LineFormat, buffer: &mut Vec<u8>, is_unsynchronized: &mut bool) -> Vec<StreamPiece> {
    let mut pieces = Vec::new();
    while let Some(at) = find_bytes(buffer, &layout.line_end) {
        let rest = buffer.split_off(at + layout.line_end.len());
        let ended = std::mem::replace(buffer, rest);
        let line = ended.get(..at).unwrap_or_default().trim_ascii();
        // An empty line is ignored: a line end of two characters can produce an empty line.
        if std::mem::take(is_unsynchronized) || line.is_empty() {
            continue;
        }
        pieces.push(match layout.decode(line) {
            Some(sample) => StreamPiece::Decoded { sample, consumed_byte_count: ended.len() },
            None => StreamPiece::Undecodable(line.to_vec()),
        });
    }
    if buffer.len() > MAX_LINE_BYTES {
        pieces.push(StreamPiece::Undecodable(std::mem::take(buffer)));
        *is_unsynchronized = true;
    }
    pieces
}

/// Takes all valid frames from `buffer`. Bytes that belong to no frame are undecodable; if the bytes may begin within a
/// frame, those before a frame in the same call are dropped instead.
fn split_frames(layout: &frame::FrameFormat, buffer: &mut Vec<u8>, is_unsynchronized: &mut bool) -> Vec<StreamPiece> {
    let mut pieces = Vec::new();
    let mut invalid = Vec::new();
    loop {
        // Keep bytes that may be the beginning of a frame.
        let begin =
            find_bytes(buffer, &layout.sync).unwrap_or_else(|| buffer.len().saturating_sub(layout.sync.len() - 1));
        invalid.extend(buffer.drain(..begin));
        let Some(frame) = buffer.get(..layout.frame_length()) else { break };
        match layout.decode(frame) {
            Some(sample) => {
                buffer.drain(..layout.frame_length());
                if !std::mem::take(is_unsynchronized) && !invalid.is_empty() {
                    pieces.push(StreamPiece::Undecodable(std::mem::take(&mut invalid)));
                }
                invalid.clear();
                pieces.push(StreamPiece::Decoded { sample, consumed_byte_count: layout.frame_length() });
            }
            // The sync bytes were there by chance, or bytes after them are missing.
            None => invalid.extend(buffer.drain(..1)),
        }
    }
    // Bytes before the first valid piece count as invalid too: they may be noise.
    if !invalid.is_empty() {
        pieces.push(StreamPiece::Undecodable(invalid));
    }
    pieces
}

fn find_bytes(bytes: &[u8], pattern: &[u8]) -> Option<usize> {
    bytes.windows(pattern.len()).position(|window| window == pattern)
}
