//! Register map: address and format of each item of the window, from `[controller.registers]`. An omitted
//! item is as published in `docs/line-window.md`, or with a resident program in `docs/resident-program.md`.

pub(super) mod check;
pub(super) mod keys;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use serde::Deserialize;

use link::modbus::value::{ByteOrder, NumberFormat, RegisterValueError};
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
    pub number: NumberFormat,
}

/// A block of registers for one command: text, two characters a register; or the parameters of a resident program.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ChunkRegisters {
    pub address: u16,
    pub registers: u16,
    pub order: ByteOrder,
}

/// Holding registers that `trued` writes.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CommandRegisters {
    pub hold: Register,
    pub sequence: Register,
    pub heartbeat: Register,
    pub acknowledge: Register,
    pub crc: Register,
    pub length: Register,
    pub chunk: ChunkRegisters,
}

/// Registers that the control writes, read in one request from `sequence_head` to `sequence_tail`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct StatusRegisters {
    pub space: RegisterSpace,
    pub sequence_head: Register,
    pub version: Register,
    pub state: Register,
    pub alarm: Register,
    pub accepted: Register,
    pub executed: Register,
    pub error: Register,
    pub probe: Register,
    pub inputs: Register,
    pub latches: Register,
    pub heartbeat: Register,
    pub time_s: Register,
    pub latch_time_s: Register,
    pub latch: BTreeMap<Axis, Register>,
    pub position: BTreeMap<Axis, Register>,
    pub sequence_tail: Register,
    /// Registers of the results, only with a resident program.
    pub result: Option<ResultRegisters>,
}

/// Further registers of a resident program: the row that it executes, and the result that it hands over.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ResultRegisters {
    pub under_way: Register,
    pub sequence: Register,
    pub row: Register,
    pub contact: Register,
    pub valid: Register,
}

/// Register map of the whole window.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(try_from = "keys::RegisterMapKeys")]
pub struct WindowRegisterMap {
    pub(super) command: CommandRegisters,
    pub(super) status: StatusRegisters,
}

impl Register {
    pub(super) fn count(&self) -> u16 {
        self.number.register_count()
    }

    /// Reads the number from a block of registers that begins at `first`.
    pub(super) fn read(&self, block: &[u16], first: u16) -> Result<f64, RegisterValueError> {
        let wanted = self.count();
        let start = usize::from(self.address.saturating_sub(first));
        let words = block.get(start..start + usize::from(wanted));
        self.number.decode(words.ok_or(RegisterValueError::RegisterCount { received: block.len(), expected: wanted })?)
    }

    /// Returns the address and the words of `value`.
    pub(super) fn write(&self, value: u16) -> Result<(u16, Vec<u16>), RegisterValueError> {
        Ok((self.address, self.number.encode(f64::from(value))?))
    }
}

impl ChunkRegisters {
    /// Capacity of the chunk, bytes.
    pub(super) fn capacity_bytes(&self) -> usize {
        2 * usize::from(self.registers)
    }

    /// Returns the address and the words of the text, the first character in the high byte unless bytes are
    /// swapped.
    pub(super) fn write(&self, text: &[u8]) -> (u16, Vec<u16>) {
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
    fn register_spans(&self) -> Vec<(&'static str, u16, u16)> {
        let items = [
            ("hold", self.hold),
            ("sequence", self.sequence),
            ("heartbeat", self.heartbeat),
            ("acknowledge", self.acknowledge),
            ("crc", self.crc),
            ("length", self.length),
        ];
        let items = items.map(|(name, register)| (name, register.address, register.count()));
        items.into_iter().chain([("chunk", self.chunk.address, self.chunk.registers)]).collect()
    }
}

impl StatusRegisters {
    /// Returns the first register of the status block, and the number of its registers.
    pub(super) fn block_range(&self) -> (u16, u16) {
        let (first, tail) = (self.sequence_head.address, self.sequence_tail);
        (first, tail.address.saturating_add(tail.count()).saturating_sub(first))
    }

    fn register_spans(&self) -> Vec<(String, u16, u16)> {
        let items = [
            ("sequence_head", self.sequence_head),
            ("version", self.version),
            ("state", self.state),
            ("alarm", self.alarm),
            ("accepted", self.accepted),
            ("executed", self.executed),
            ("error", self.error),
            ("probe", self.probe),
            ("inputs", self.inputs),
            ("latches", self.latches),
            ("heartbeat", self.heartbeat),
            ("time_s", self.time_s),
            ("latch_time_s", self.latch_time_s),
            ("sequence_tail", self.sequence_tail),
        ];
        let items = items.into_iter().map(|(name, register)| (name.to_owned(), register));
        let of = |name: &'static str| move |(axis, at): (&Axis, &Register)| (format!("{name}.{axis}"), *at);
        let results = self.result.iter().flat_map(ResultRegisters::named_registers);
        let results = results.map(|(name, register)| (format!("result.{name}"), register));
        items
            .chain(results)
            .chain(self.latch.iter().map(of("latch")))
            .chain(self.position.iter().map(of("position")))
            .map(|(name, register)| (name, register.address, register.count()))
            .collect()
    }
}

impl ResultRegisters {
    fn named_registers(&self) -> [(&'static str, Register); 5] {
        [
            ("under_way", self.under_way),
            ("sequence", self.sequence),
            ("row", self.row),
            ("contact", self.contact),
            ("valid", self.valid),
        ]
    }
}

impl WindowRegisterMap {
    /// Ranges that the link may access: the status to read, the command block to write.
    pub(super) fn access_ranges(&self) -> AccessList {
        let (first, count) = self.status.block_range();
        let last = first.saturating_add(count.saturating_sub(1));
        let read = vec![RegisterRange { space: self.status.space, first, last }];
        let mut spans: Vec<(u16, u16)> =
            self.command.register_spans().into_iter().map(|(_, first, count)| (first, count)).collect();
        spans.sort_unstable();
        let mut write: Vec<RegisterRange> = Vec::new();
        for (first, count) in spans {
            let last = first.saturating_add(count.saturating_sub(1));
            match write.last_mut() {
                // One request may write adjacent items.
                Some(range) if range.last.checked_add(1) == Some(first) => range.last = last,
                _ => write.push(RegisterRange { space: RegisterSpace::Holding, first, last }),
            }
        }
        AccessList { readable: read, writable: write }
    }

    /// Returns an axis without registers in the window.
    pub(super) fn axis_without_registers(&self, axes: &[Axis]) -> Option<Axis> {
        let has_registers =
            |axis: &&Axis| self.status.latch.contains_key(axis) && self.status.position.contains_key(axis);
        axes.iter().find(|axis| !has_registers(axis)).copied()
    }
}
