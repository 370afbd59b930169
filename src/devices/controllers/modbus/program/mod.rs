//! A resident program behind the window: for a control that executes no lines, but holds a measuring
//! program of its own, which a register starts. `docs/resident-program.md` publishes what it must do.
//! Instead of a line the chunk holds the program's parameters: one [`Block`](machine::record::motion::Block)
//! as a table of rows. Its result comes back through a slot that is handed over and acknowledged.
//!
//! - **Nothing unproven starts.** The block is rendered, and the text proven, as for every control. The
//!   rows are made of that text as it is read back, and the registers are read again as numbers and
//!   compared with it before they are written.
//! - **Nothing half-written starts.** What was written is read back; the check sum covers all of it, and
//!   with it the one sequence that may start it.
//! - **A start happens once.** After an unanswered one the control tells whether it took it.
//! - **A result counts once.** It has a number, and names the call and the row that it is of.

mod call;
mod layout;
mod rows;
#[cfg(test)]
mod tests;

use serde::Deserialize;

use layout::{Layout, ParameterKeys, RowKeys};

use super::map::Map;

/// `[controller.program]`.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Keys {
    number: Option<u16>,
    tool: u16,
    parameters: ParameterKeys,
    row: RowKeys,
}

/// Which program, and where its parameters lie in the chunk.
#[derive(Debug, Clone)]
pub(super) struct Program {
    pub number: u16,
    /// The probe's number there; 0: the program need not look.
    tool: u16,
    layout: Layout,
}

impl Program {
    /// # Errors
    /// Parameters that do not fit the chunk of `map`, or lie over each other.
    pub(super) fn of(keys: Keys, map: &Map) -> Result<Self, String> {
        let Keys { number, tool, parameters, row } = keys;
        let layout = Layout::of(parameters, row, map.command.chunk.registers)?;
        Ok(Self { number: number.unwrap_or(1), tool, layout })
    }
}
