//! Registers that may be read or written.

use super::register_access::{MAX_READ_BITS, MAX_READ_REGISTERS, MAX_WRITE_REGISTERS, RegisterAccess};
use super::{ModbusError, RegisterSpace};

/// Registers `first` to `last`, both inclusive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RegisterRange {
    pub space: RegisterSpace,
    pub first: u16,
    pub last: u16,
}

/// Registers that a client may access. A writable register is also readable, because each write is read back.
#[derive(Debug, Clone, Default)]
pub struct AccessList {
    pub readable: Vec<RegisterRange>,
    /// Ranges of holding registers; other spaces are never written.
    pub writable: Vec<RegisterRange>,
}

impl RegisterRange {
    /// Whether the range covers all registers of the access.
    fn contains(&self, access: &RegisterAccess) -> bool {
        let end = usize::from(access.address) + usize::from(access.register_or_bit_count);
        self.space == access.space && self.first <= access.address && end <= usize::from(self.last) + 1
    }
}

impl AccessList {
    pub fn read_only(readable: Vec<RegisterRange>) -> Self {
        Self { readable, writable: Vec::new() }
    }

    /// Checks that the count is within the limits of one request, and that one range alone covers all registers.
    ///
    /// # Errors
    /// [`ModbusError::NotAllowed`], with the reason.
    pub(super) fn check_access(&self, access: &RegisterAccess) -> Result<(), ModbusError> {
        let max_count = match (access.is_write(), access.space.has_bits()) {
            (true, _) => MAX_WRITE_REGISTERS,
            (false, true) => MAX_READ_BITS,
            (false, false) => MAX_READ_REGISTERS,
        };
        let refused = |why: String| Err(ModbusError::NotAllowed { request: access.to_string(), why });
        if access.register_or_bit_count == 0 || access.register_or_bit_count > max_count {
            let count = access.register_or_bit_count;
            return refused(format!("the request has {count} registers or bits; permitted: 1 to {max_count}"));
        }
        let covers = |range: &RegisterRange| range.contains(access);
        if self.writable.iter().any(covers) || !access.is_write() && self.readable.iter().any(covers) {
            return Ok(());
        }
        refused("the registers are not within one permitted range".to_owned())
    }

    /// Reads from the start of each permitted range, at most eight per range, each with another reply length within the
    /// range.
    pub(super) fn reads_of_distinct_reply_length(&self) -> impl Iterator<Item = RegisterAccess> + '_ {
        let readable = self.readable.iter().chain(&self.writable);
        readable.flat_map(|range| {
            let RegisterRange { space, first, last } = *range;
            // Bits are transferred in whole bytes, so only one count per byte gives a distinct reply length.
            let step = if space.has_bits() { 8 } else { 1 };
            let max_count = last.saturating_sub(first).saturating_add(1);
            (0..8)
                .map(move |more| 1 + more * step)
                .take_while(move |count| *count <= max_count)
                .map(move |count| RegisterAccess::new_read(space, first, count))
        })
    }
}
