//! Cuts a byte stream into whole pieces. The stream may be split anywhere, unreadable, or without an end of
//! line.

use super::form::Form;
use super::{frame, line};
use crate::sensors::layout::Decoded;

/// Maximum length of a line, bytes; longer input is not a line.
const LONGEST: usize = 512;

#[derive(Debug, PartialEq)]
pub(super) enum Piece {
    Whole {
        said: Decoded,
        bytes: usize,
    },
    /// Bytes that cannot be decoded.
    Undecodable(Vec<u8>),
}

#[derive(Debug)]
pub(super) struct Cutter {
    form: Form,
    held: Vec<u8>,
    /// Whether the bytes may begin within a piece: everything before the next start of a piece is ignored.
    fresh: bool,
}

impl Cutter {
    pub fn new(form: Form) -> Self {
        Self { form, held: Vec::new(), fresh: true }
    }

    /// Discards all bytes held. `within`: the next bytes may begin within a piece.
    pub fn begin(&mut self, within: bool) {
        self.held.clear();
        self.fresh = within;
    }

    /// Returns all pieces that `bytes` completes, in order.
    pub fn push(&mut self, bytes: &[u8]) -> Vec<Piece> {
        self.held.extend_from_slice(bytes);
        match &self.form {
            Form::Line(layout) => lines(layout, &mut self.held, &mut self.fresh),
            Form::Frame(layout) => frames(layout, &mut self.held, &mut self.fresh),
        }
    }
}

fn lines(layout: &line::Layout, held: &mut Vec<u8>, fresh: &mut bool) -> Vec<Piece> {
    let mut pieces = Vec::new();
    while let Some(at) = find(held, &layout.end) {
        let rest = held.split_off(at + layout.end.len());
        let ended = std::mem::replace(held, rest);
        let line = ended.get(..at).unwrap_or_default().trim_ascii();
        // An empty line is ignored: some line ends consist of two others.
        if std::mem::take(fresh) || line.is_empty() {
            continue;
        }
        pieces.push(match layout.read(line) {
            Some(said) => Piece::Whole { said, bytes: ended.len() },
            None => Piece::Undecodable(line.to_vec()),
        });
    }
    if held.len() > LONGEST {
        pieces.push(Piece::Undecodable(std::mem::take(held)));
        *fresh = true;
    }
    pieces
}

fn frames(layout: &frame::Layout, held: &mut Vec<u8>, fresh: &mut bool) -> Vec<Piece> {
    let mut pieces = Vec::new();
    let mut spoilt = Vec::new();
    loop {
        // Keep bytes that may be the beginning of a frame.
        let begin = find(held, &layout.sync)
            .unwrap_or_else(|| held.len().saturating_sub(layout.sync.len() - 1));
        spoilt.extend(held.drain(..begin));
        let Some(frame) = held.get(..layout.whole()) else { break };
        match layout.read(frame) {
            Some(said) => {
                held.drain(..layout.whole());
                if !std::mem::take(fresh) && !spoilt.is_empty() {
                    pieces.push(Piece::Undecodable(std::mem::take(&mut spoilt)));
                }
                spoilt.clear();
                pieces.push(Piece::Whole { said, bytes: layout.whole() });
            }
            // The sync bytes were there by chance, or bytes after them are missing.
            None => spoilt.extend(held.drain(..1)),
        }
    }
    // Bytes before the first valid piece count as invalid too: they may be noise.
    if !spoilt.is_empty() {
        pieces.push(Piece::Undecodable(spoilt));
    }
    pieces
}

fn find(bytes: &[u8], what: &[u8]) -> Option<usize> {
    bytes.windows(what.len()).position(|window| window == what)
}
