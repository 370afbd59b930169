//! Register map: address and format of each item of the window, from `[controller.registers]`. An omitted
//! item is as published in `docs/line-window.md`, or with a resident program in `docs/resident-program.md`.

pub(super) mod check;
pub(super) mod keys;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use serde::Deserialize;

use link::modbus::number_format::{ByteOrder, NumberFormat, RegisterValueError};
use link::modbus::{AccessList, RegisterRange, RegisterSpace};
use machine::Axis;

/// Maximum number of registers that one request may write (Modbus application protocol, function 16).
pub(super) const MAX_WRITE_REGISTERS: usize = 123;
/// Maximum number of registers that one request may read (functions 3 and 4).
const MAX_READ_REGISTERS: usize = 125;

/// One item: its first register and the format of its number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Register {
    pub address: u16,
    pub number_format: NumberFormat,
}

/// A block of registers for one command: text, two characters a register; or the parameters of a resident program.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ChunkRegisters {
    pub address: u16,
    pub register_count: u16,
    /// Order of the two characters of each register; the order of words has no effect. With a resident program always
    /// the default, `Abcd`: another order is refused.
    pub order: ByteOrder,
}

/// Holding registers that `trued` writes.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CommandRegisters {
    /// 1: the control holds the machine.
    pub hold: Register,
    /// Sequence number of the chunk. The control acts on the chunk when the number changes.
    pub sequence: Register,
    /// Heartbeat of `trued`.
    pub heartbeat: Register,
    /// Number of the last result that was read; without results, of the last checked chunk.
    pub result_acknowledge: Register,
    /// CRC-16/MODBUS of the chunk's bytes.
    pub chunk_crc: Register,
    /// Length of the chunk, bytes.
    pub chunk_length: Register,
    pub chunk: ChunkRegisters,
}

/// Registers that the control writes, read in one request from `sequence_head` to `sequence_tail`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct StatusRegisters {
    pub space: RegisterSpace,
    /// Counter of the status blocks. A value other than in `sequence_tail`: the block changed during the read.
    pub sequence_head: Register,
    /// Version of the window layout, which shows whether the window is for lines or for a resident program.
    pub window_version: Register,
    /// 0: not ready; 1: idle; 2: running; 3: held; 4: alarm.
    pub state: Register,
    /// Code of the alarm; in the state `held`, the reason of the hold.
    pub alarm_code: Register,
    /// Last sequence that the control has checked, accepted or refused.
    pub checked_sequence: Register,
    /// Last sequence whose execution is complete.
    pub executed_sequence: Register,
    /// Reason why `checked_sequence` was refused; 0: accepted.
    pub refusal_code: Register,
    /// 0: open; any other number: closed.
    pub probe_closed_flag: Register,
    /// One bit for each input: A is bit 0.
    pub input_bits: Register,
    /// Number of contacts so far; with a resident program, number of results.
    pub latch_count: Register,
    /// Heartbeat of the control's program.
    pub heartbeat: Register,
    /// Present time of the control's clock; 0: the control has no clock.
    pub control_time_s: Register,
    /// Time of the last contact on the control's clock; 0: the control has no clock.
    pub latch_time_s: Register,
    /// Position of each axis at the last contact, mm or degrees.
    pub latched_position: BTreeMap<Axis, Register>,
    /// Present position of each axis, mm or degrees.
    pub position: BTreeMap<Axis, Register>,
    /// Same value as `sequence_head`, unless the block changed during the read.
    pub sequence_tail: Register,
    /// Registers of the results, only with a resident program.
    pub result: Option<ResultRegisters>,
}

/// Further registers of a resident program: the row that the program executes, and the result that it reports.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ResultRegisters {
    /// Row that the program executes, from 1; 0: none.
    pub active_row_number: Register,
    /// Sequence of the call to which the result belongs.
    pub call_sequence: Register,
    /// Row to which the result belongs, from 1.
    pub row_number: Register,
    /// 0: the row ended without a contact.
    pub contact_flag: Register,
    /// 1 until the result is acknowledged.
    pub unacknowledged_flag: Register,
}

/// Register map of the whole window.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(try_from = "keys::RegisterMapKeys")]
pub struct WindowRegisterMap {
    pub(super) command: CommandRegisters,
    pub(super) status: StatusRegisters,
}

impl Register {
    pub(super) fn register_count(&self) -> u16 {
        self.number_format.register_count()
    }

    /// Reads the number, with its scale applied, from a block of registers that begins at the address `first`.
    pub(super) fn decode_from_block(&self, block: &[u16], first: u16) -> Result<f64, RegisterValueError> {
        let wanted = self.register_count();
        let start = usize::from(self.address.saturating_sub(first));
        let words = block.get(start..start + usize::from(wanted));
        self.number_format
            .decode(words.ok_or(RegisterValueError::WrongRegisterCount { received: block.len(), expected: wanted })?)
    }

    /// Returns the address and the words of `value` for a write.
    pub(super) fn encode_value(&self, value: u16) -> Result<(u16, Vec<u16>), RegisterValueError> {
        Ok((self.address, self.number_format.encode(f64::from(value))?))
    }
}

impl ChunkRegisters {
    /// Capacity of the chunk, bytes.
    pub(super) fn capacity_bytes(&self) -> usize {
        2 * usize::from(self.register_count)
    }

    /// Returns the address and the words of the text for a write, the first character in the high byte unless bytes are
    /// swapped.
    pub(super) fn encode_text(&self, text: &[u8]) -> (u16, Vec<u16>) {
        let word = |pair: &[u8]| {
            let pair = [pair.first().copied(), pair.get(1).copied()].map(Option::unwrap_or_default);
            match self.order {
                ByteOrder::Abcd | ByteOrder::Cdab => u16::from_be_bytes(pair),
                ByteOrder::Badc | ByteOrder::Dcba => u16::from_le_bytes(pair),
            }
        };
        (self.address, text.chunks(2).map(word).collect())
    }
}

impl CommandRegisters {
    /// Name, first register and number of registers of each item.
    fn register_names_addresses_and_counts(&self) -> Vec<(&'static str, u16, u16)> {
        let items = [
            ("hold", self.hold),
            ("sequence", self.sequence),
            ("heartbeat", self.heartbeat),
            ("acknowledge", self.result_acknowledge),
            ("crc", self.chunk_crc),
            ("length", self.chunk_length),
        ];
        let items = items.map(|(name, register)| (name, register.address, register.register_count()));
        items.into_iter().chain([("chunk", self.chunk.address, self.chunk.register_count)]).collect()
    }
}

impl StatusRegisters {
    /// Returns the first register of the status block, and the number of its registers.
    pub(super) fn block_first_and_count(&self) -> (u16, u16) {
        let (first, tail) = (self.sequence_head.address, self.sequence_tail);
        (first, tail.address.saturating_add(tail.register_count()).saturating_sub(first))
    }

    /// Name, first register and number of registers of each item.
    fn register_names_addresses_and_counts(&self) -> Vec<(String, u16, u16)> {
        let items = [
            ("sequence_head", self.sequence_head),
            ("version", self.window_version),
            ("state", self.state),
            ("alarm", self.alarm_code),
            ("accepted", self.checked_sequence),
            ("executed", self.executed_sequence),
            ("error", self.refusal_code),
            ("probe", self.probe_closed_flag),
            ("inputs", self.input_bits),
            ("latches", self.latch_count),
            ("heartbeat", self.heartbeat),
            ("time_s", self.control_time_s),
            ("latch_time_s", self.latch_time_s),
            ("sequence_tail", self.sequence_tail),
        ];
        let items = items.into_iter().map(|(name, register)| (name.to_owned(), register));
        let of = |name: &'static str| move |(axis, at): (&Axis, &Register)| (format!("{name}.{axis}"), *at);
        let results = self.result.iter().flat_map(ResultRegisters::named_registers);
        let results = results.map(|(name, register)| (format!("result.{name}"), register));
        items
            .chain(results)
            .chain(self.latched_position.iter().map(of("latch")))
            .chain(self.position.iter().map(of("position")))
            .map(|(name, register)| (name, register.address, register.register_count()))
            .collect()
    }
}

impl ResultRegisters {
    /// Keys of `[controller.registers.status.result]` with their registers.
    fn named_registers(&self) -> [(&'static str, Register); 5] {
        [
            ("under_way", self.active_row_number),
            ("sequence", self.call_sequence),
            ("row", self.row_number),
            ("contact", self.contact_flag),
            ("valid", self.unacknowledged_flag),
        ]
    }
}

impl WindowRegisterMap {
    /// Ranges that the link may access: the status to read, the command block to write.
    pub(super) fn access_ranges(&self) -> AccessList {
        let (first, count) = self.status.block_first_and_count();
        let last = first.saturating_add(count.saturating_sub(1));
        let read = vec![RegisterRange { space: self.status.space, first, last }];
        let mut spans = self.command.register_names_addresses_and_counts();
        spans.sort_unstable_by_key(|(_, first, count)| (*first, *count));
        let mut write: Vec<RegisterRange> = Vec::new();
        for (_, first, count) in spans {
            let last = first.saturating_add(count.saturating_sub(1));
            match write.last_mut() {
                // One request may write adjacent items.
                Some(range) if range.last.checked_add(1) == Some(first) => range.last = last,
                _ => write.push(RegisterRange { space: RegisterSpace::Holding, first, last }),
            }
        }
        AccessList { readable: read, writable: write }
    }

    /// Returns the first of `axes` that lacks a register for its position or its latched position; `None` if each has
    /// both.
    pub(super) fn axis_without_registers(&self, axes: &[Axis]) -> Option<Axis> {
        let has_registers =
            |axis: &&Axis| self.status.latched_position.contains_key(axis) && self.status.position.contains_key(axis);
        axes.iter().find(|axis| !has_registers(axis)).copied()
    }
}
