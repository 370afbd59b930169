//! Registers that may be read or written.

use super::access::{MAX_READ_BITS, MAX_READ_REGISTERS, MAX_WRITE_REGISTERS, RegisterAccess};
use super::{ModbusError, RegisterSpace};

/// Registers `first` to `last`, both inclusive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RegisterRange {
    pub space: RegisterSpace,
    pub first: u16,
    pub last: u16,
}

/// Access list. A writable register is also readable, because each write is read back.
#[derive(Debug, Clone, Default)]
pub struct AccessList {
    pub read: Vec<RegisterRange>,
    /// Ranges of holding registers; other spaces are never written.
    pub write: Vec<RegisterRange>,
}

impl RegisterRange {
    fn contains(&self, space: RegisterSpace, address: u16, count: usize) -> bool {
        let end = usize::from(address) + count;
        self.space == space && self.first <= address && end <= usize::from(self.last) + 1
    }
}

impl AccessList {
    /// # Errors
    /// [`ModbusError::NotAllowed`], with the reason.
    pub(super) fn check(&self, access: &RegisterAccess) -> Result<(), ModbusError> {
        let (space, address, count, max_count, writes) = match access {
            RegisterAccess::Read { space: space @ (RegisterSpace::Coil | RegisterSpace::Discrete), address, count } => {
                (*space, *address, *count, MAX_READ_BITS, false)
            }
            RegisterAccess::Read { space, address, count } => (*space, *address, *count, MAX_READ_REGISTERS, false),
            RegisterAccess::Write { address, words } => {
                let count = u16::try_from(words.len()).unwrap_or(u16::MAX);
                (RegisterSpace::Holding, *address, count, MAX_WRITE_REGISTERS, true)
            }
        };
        let refused = |why: String| Err(ModbusError::NotAllowed { request: access.to_string(), why });
        if count == 0 || count > max_count {
            return refused(format!("the request has {count} registers or bits; permitted: 1 to {max_count}"));
        }
        let covers = |range: &RegisterRange| range.contains(space, address, usize::from(count));
        let written = self.write.iter().any(covers);
        if written || !writes && self.read.iter().any(covers) {
            return Ok(());
        }
        refused("the registers are not within one permitted range".to_owned())
    }

    /// Read requests for the readable registers, each of a few registers.
    pub(super) fn small_reads(&self) -> impl Iterator<Item = RegisterAccess> + '_ {
        let readable = self.read.iter().chain(&self.write);
        readable.flat_map(|range| {
            let RegisterRange { space, first, last } = *range;
            // Bits are transferred in whole bytes, so only one count per byte gives a distinct reply length.
            let step = if matches!(space, RegisterSpace::Coil | RegisterSpace::Discrete) { 8 } else { 1 };
            let max_count = last.saturating_sub(first).saturating_add(1);
            (0..8)
                .map(move |more| 1 + more * step)
                .take_while(move |count| *count <= max_count)
                .map(move |count| RegisterAccess::Read { space, address: first, count })
        })
    }
}
