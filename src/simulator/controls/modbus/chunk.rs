//! Acceptance of a chunk: each chunk is executed at most once.

use super::layout::{ACKNOWLEDGE, CHUNK, CRC, LENGTH, SEQUENCE};
use super::{Entry, Firmware, Mode};

pub(super) const BAD_LENGTH: u16 = 1;
const BAD_CRC: u16 = 2;
pub(super) const BAD_TEXT: u16 = 3;
pub(super) const BAD_ROW: u16 = 3;
const NOT_ACKNOWLEDGED: u16 = 4;
const NO_HEARTBEAT: u16 = 5;
const BUSY: u16 = 6;

impl Firmware {
    /// Handles a write of the sequence register.
    pub(super) fn sequence_written(&mut self) {
        let sequence = self.command[SEQUENCE];
        self.note(Entry::Asked { sequence });
        let follows = if self.accepted == u16::MAX { 1 } else { self.accepted + 1 };
        if sequence != follows || self.frozen.is_some() {
            return;
        }
        let before = std::mem::replace(&mut self.accepted, sequence);
        match self.bytes(before).and_then(|bytes| self.take(sequence, bytes)) {
            Err(error) => self.error = error,
            Ok(text) => {
                self.error = 0;
                self.taken += 1;
                self.note(Entry::Took { sequence, text });
            }
        }
    }

    /// Accepts lines to execute, or a table; returns the text for the diary.
    fn take(&mut self, sequence: u16, bytes: Vec<u8>) -> Result<String, u16> {
        if self.resident.is_some() {
            let word = |pair: &[u8]| pair.iter().fold(0, |word, byte| word << 8 | u16::from(*byte));
            let words: Vec<u16> = bytes.chunks(2).map(word).collect();
            return self.begin_program(sequence, &words);
        }
        let text = String::from_utf8(bytes).map_err(|_| BAD_TEXT)?;
        self.lines = text.lines().map(str::to_owned).collect();
        Ok(text)
    }

    /// Bytes of the chunk, if it may be accepted.
    fn bytes(&self, before: u16) -> Result<Vec<u8>, u16> {
        if self.mode != Mode::Ready || self.is_moving() {
            return Err(BUSY);
        }
        if !self.beats(self.now) {
            return Err(NO_HEARTBEAT);
        }
        let told = match &self.resident {
            Some(resident) => !resident.slot.valid,
            None => self.command[ACKNOWLEDGE] == before,
        };
        if !told {
            return Err(NOT_ACKNOWLEDGED);
        }
        let length = usize::from(self.command[LENGTH]);
        if length == 0 || length > 2 * (self.command.len() - CHUNK) {
            return Err(BAD_LENGTH);
        }
        let words = self.command[CHUNK..].iter();
        let bytes: Vec<u8> = words.flat_map(|word| word.to_be_bytes()).take(length).collect();
        if check_sum(&bytes) != self.command[CRC] {
            return Err(BAD_CRC);
        }
        Ok(bytes)
    }
}

/// CRC-16/MODBUS, computed as a bitwise division of the text with the bits of each byte reversed.
fn check_sum(bytes: &[u8]) -> u16 {
    let mut rest = u16::MAX;
    for byte in bytes {
        rest ^= u16::from(byte.reverse_bits()) << 8;
        for _ in 0..8 {
            let carry = rest & 0x8000 != 0;
            rest <<= 1;
            if carry {
                rest ^= 0x8005;
            }
        }
    }
    rest.reverse_bits()
}
