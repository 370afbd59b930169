//! Registers that may be read or written.

use super::ask::{Ask, MOST_BITS, MOST_READ, MOST_WRITTEN};
use super::{ModbusError, Space};

/// Registers `first` to `last`, both inclusive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Range {
    pub space: Space,
    pub first: u16,
    pub last: u16,
}

/// Access list. A writable register is also readable, because each write is read back.
#[derive(Debug, Clone, Default)]
pub struct Allowed {
    pub read: Vec<Range>,
    /// Ranges of holding registers; other spaces are never written.
    pub write: Vec<Range>,
}

impl Range {
    fn holds(&self, space: Space, address: u16, count: usize) -> bool {
        let end = usize::from(address) + count;
        self.space == space && self.first <= address && end <= usize::from(self.last) + 1
    }
}

impl Allowed {
    /// # Errors
    /// [`ModbusError::NotAllowed`], with the reason.
    pub(super) fn check(&self, ask: &Ask) -> Result<(), ModbusError> {
        let (space, address, count, most, writes) = match ask {
            Ask::Read { space: space @ (Space::Coil | Space::Discrete), address, count } => {
                (*space, *address, *count, MOST_BITS, false)
            }
            Ask::Read { space, address, count } => (*space, *address, *count, MOST_READ, false),
            Ask::Write { address, words } => {
                let count = u16::try_from(words.len()).unwrap_or(u16::MAX);
                (Space::Holding, *address, count, MOST_WRITTEN, true)
            }
        };
        let refused = |why: String| Err(ModbusError::NotAllowed { request: ask.to_string(), why });
        if count == 0 || count > most {
            return refused(format!("one request takes 1 to {most} of them, not {count}"));
        }
        let covers = |range: &Range| range.holds(space, address, usize::from(count));
        let written = self.write.iter().any(covers);
        if written || !writes && self.read.iter().any(covers) {
            return Ok(());
        }
        refused("they do not lie in one range of the list of what may be reached".to_owned())
    }

    /// Read requests for the readable registers, each of a few registers.
    pub(super) fn small_reads(&self) -> impl Iterator<Item = Ask> + '_ {
        let readable = self.read.iter().chain(&self.write);
        readable.flat_map(|range| {
            let Range { space, first, last } = *range;
            // Bits are transferred in whole bytes, so only one count per byte gives a distinct reply length.
            let step = if matches!(space, Space::Coil | Space::Discrete) { 8 } else { 1 };
            let most = last.saturating_sub(first).saturating_add(1);
            (0..8)
                .map(move |more| 1 + more * step)
                .take_while(move |count| *count <= most)
                .map(move |count| Ask::Read { space, address: first, count })
        })
    }
}
