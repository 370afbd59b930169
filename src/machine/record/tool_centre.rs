//! The tool centre as the control computes it.

use serde::{Deserialize, Serialize};

use crate::Position;

/// The tool centre by the control at one standstill, with tool centre point control switched on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ToolCentreReading {
    /// Positions of the axes of the machine, without tool centre point control.
    pub position: Position,
    /// X, Y, Z of the control, with the length of the stated stylus: in the workpiece, with all rotary axes at zero.
    pub tool_centre_mm: [f64; 3],
}
