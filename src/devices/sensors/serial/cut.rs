//! Bytes to whole pieces, whatever comes: split anywhere, unreadable, endless.

use super::form::Form;
use super::{frame, line};
use crate::sensors::layout::Decoded;

/// A line that is longer is no line.
const LONGEST: usize = 512;

#[derive(Debug, PartialEq)]
pub(super) enum Piece {
    Whole {
        said: Decoded,
        bytes: usize,
    },
    /// It cannot be understood.
    Spoilt(Vec<u8>),
}

#[derive(Debug)]
pub(super) struct Cutter {
    form: Form,
    held: Vec<u8>,
    /// It is not known where in a piece the bytes begin: up to the next beginning nothing counts.
    fresh: bool,
}

impl Cutter {
    pub fn new(form: Form) -> Self {
        Self { form, held: Vec::new(), fresh: true }
    }

    /// Everything held is forgotten; `within`: what comes may begin within a piece.
    pub fn begin(&mut self, within: bool) {
        self.held.clear();
        self.fresh = within;
    }

    /// All that `bytes` completes, in order.
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
        // An empty line says nothing: some ends are two of another kind.
        if std::mem::take(fresh) || line.is_empty() {
            continue;
        }
        pieces.push(match layout.read(line) {
            Some(said) => Piece::Whole { said, bytes: ended.len() },
            None => Piece::Spoilt(line.to_vec()),
        });
    }
    if held.len() > LONGEST {
        pieces.push(Piece::Spoilt(std::mem::take(held)));
        *fresh = true;
    }
    pieces
}

fn frames(layout: &frame::Layout, held: &mut Vec<u8>, fresh: &mut bool) -> Vec<Piece> {
    let mut pieces = Vec::new();
    let mut spoilt = Vec::new();
    loop {
        // What may still be the beginning of a frame stays.
        let begin = find(held, &layout.sync)
            .unwrap_or_else(|| held.len().saturating_sub(layout.sync.len() - 1));
        spoilt.extend(held.drain(..begin));
        let Some(frame) = held.get(..layout.whole()) else { break };
        match layout.read(frame) {
            Some(said) => {
                held.drain(..layout.whole());
                if !std::mem::take(fresh) && !spoilt.is_empty() {
                    pieces.push(Piece::Spoilt(std::mem::take(&mut spoilt)));
                }
                spoilt.clear();
                pieces.push(Piece::Whole { said, bytes: layout.whole() });
            }
            // Those bytes stood there by chance, or something is missing behind them.
            None => spoilt.extend(held.drain(..1)),
        }
    }
    // While nothing was understood it counts all the same: it may be noise.
    if !spoilt.is_empty() {
        pieces.push(Piece::Spoilt(spoilt));
    }
    pieces
}

fn find(bytes: &[u8], what: &[u8]) -> Option<usize> {
    bytes.windows(what.len()).position(|window| window == what)
}
