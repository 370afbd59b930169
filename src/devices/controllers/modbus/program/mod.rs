//! Resident program behind the window: for a control that executes no lines, but has a measuring program of
//! its own, which a register starts. `docs/resident-program.md` specifies this program. Instead of a line
//! the chunk holds the program's parameters: one [`MotionBlock`](machine::record::motion::MotionBlock) as a table of
//! rows. Its results come back one by one through a slot of registers; each is acknowledged.
//!
//! - **Only proven text is executed.** The block is rendered, and the text proven, as for every control.
//!   The rows are made from that text as it was read back; the registers are converted back to numbers and
//!   compared with the text before they are written.
//! - **No incomplete table is executed.** The written registers are read back; the checksum covers all of
//!   them, and the one sequence number that may start the program.
//! - **A start happens once.** After an unanswered start the control reports whether it has accepted it.
//! - **A result counts once.** It has a number, and names its call and its row.

mod call;
mod layout;
mod rows;
#[cfg(test)]
mod tests;

use serde::Deserialize;

use layout::{ParameterKeys, ParameterLayout, RowKeys};

use super::map::WindowRegisterMap;

/// Keys of `[controller.program]`.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct ProgramKeys {
    /// Number of the resident program; the default is 1.
    number: Option<u16>,
    /// Number of the probe as a tool of the control; 0: the program need not check the tool.
    tool: u16,
    parameters: ParameterKeys,
    row: RowKeys,
}

/// Number of the resident program, and layout of its parameters in the chunk.
#[derive(Debug, Clone)]
pub(super) struct ResidentProgram {
    pub program_number: u16,
    /// Number of the probe as a tool of the control; 0: the program need not check it.
    probe_tool_number: u16,
    layout: ParameterLayout,
}

impl ResidentProgram {
    /// # Errors
    /// The parameters do not fit the chunk of `map`, or overlap.
    pub(super) fn from_keys(keys: ProgramKeys, map: &WindowRegisterMap) -> Result<Self, String> {
        let ProgramKeys { number, tool, parameters, row } = keys;
        let layout = ParameterLayout::from_keys(parameters, row, map.command.chunk.register_count)?;
        Ok(Self { program_number: number.unwrap_or(1), probe_tool_number: tool, layout })
    }
}
