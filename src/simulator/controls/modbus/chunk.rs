//! Acceptance of a chunk: each chunk is executed at most once.

use super::layout::{
    ACKNOWLEDGE_REGISTER, CHUNK_REGISTER, CRC_REGISTER, LENGTH_REGISTER, SEQUENCE_REGISTER, register_words,
};
use super::{ControlEvent, Firmware, OperatingState};
use crate::crc16::crc16_modbus;

/// Code of the error register: the length of the chunk is 0, exceeds the block, or does not fit its table.
pub(super) const ERROR_BAD_LENGTH: u16 = 1;
const ERROR_BAD_CRC: u16 = 2;
/// A line is no UTF-8 or no valid G-code; same code as `ERROR_BAD_ROW`, which a resident program reports.
pub(super) const ERROR_BAD_TEXT: u16 = 3;
/// A row cannot be executed, or the table states another sequence number or number of touches.
pub(super) const ERROR_BAD_ROW: u16 = 3;
/// The previous chunk, or with a resident program the last result, is not acknowledged.
const ERROR_NOT_ACKNOWLEDGED: u16 = 4;
/// The client's heartbeat has not changed within the timeout.
const ERROR_NO_HEARTBEAT: u16 = 5;
/// The control is not ready, or still executes a chunk.
const ERROR_BUSY: u16 = 6;

impl Firmware {
    /// Handles a write of the sequence register. Only the number after the last checked one offers a new chunk;
    /// others, and all numbers after the program has stopped, are recorded as an event and ignored.
    pub(super) fn on_sequence_written(&mut self) {
        let sequence = self.holding_registers[SEQUENCE_REGISTER];
        self.record_event(ControlEvent::ChunkOffered { sequence });
        let next_sequence = if self.checked_sequence == u16::MAX { 1 } else { self.checked_sequence + 1 };
        if sequence != next_sequence || self.frozen_status_block.is_some() {
            return;
        }
        let checked_before = std::mem::replace(&mut self.checked_sequence, sequence);
        match self.acceptable_chunk_bytes(checked_before).and_then(|bytes| self.accept_chunk(sequence, bytes)) {
            Err(error) => self.error_code = error,
            Ok(text) => {
                self.error_code = 0;
                self.accepted_chunk_count += 1;
                self.record_event(ControlEvent::ChunkAccepted { sequence, text });
            }
        }
    }

    /// Accepts lines to execute, or a table; returns the text for the event log, or the error code.
    fn accept_chunk(&mut self, sequence: u16, bytes: Vec<u8>) -> Result<String, u16> {
        if self.resident_program.is_some() {
            return self.start_program(sequence, &register_words(&bytes));
        }
        let text = String::from_utf8(bytes).map_err(|_| ERROR_BAD_TEXT)?;
        self.unstarted_lines = text.lines().map(str::to_owned).collect();
        Ok(text)
    }

    /// Bytes of the chunk, or the error code for which it is refused. `previous_sequence`: last checked number before
    /// it.
    fn acceptable_chunk_bytes(&self, previous_sequence: u16) -> Result<Vec<u8>, u16> {
        if self.operating_state != OperatingState::Ready || self.is_running() {
            return Err(ERROR_BUSY);
        }
        if !self.is_heartbeat_current(self.time_since_start) {
            return Err(ERROR_NO_HEARTBEAT);
        }
        let is_acknowledged = match &self.resident_program {
            Some(resident) => !resident.result_slot.is_pending,
            None => self.holding_registers[ACKNOWLEDGE_REGISTER] == previous_sequence,
        };
        if !is_acknowledged {
            return Err(ERROR_NOT_ACKNOWLEDGED);
        }
        let length = usize::from(self.holding_registers[LENGTH_REGISTER]);
        if length == 0 || length > 2 * (self.holding_registers.len() - CHUNK_REGISTER) {
            return Err(ERROR_BAD_LENGTH);
        }
        let words = self.holding_registers[CHUNK_REGISTER..].iter();
        let bytes: Vec<u8> = words.flat_map(|word| word.to_be_bytes()).take(length).collect();
        if crc16_modbus(&bytes) != self.holding_registers[CRC_REGISTER] {
            return Err(ERROR_BAD_CRC);
        }
        Ok(bytes)
    }
}
