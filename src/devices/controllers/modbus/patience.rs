//! Time limits of the window's conversation.

use std::time::Duration;

/// How long the driver waits, host time.
#[derive(Debug, Clone, Copy)]
pub struct Patience {
    /// A living control takes a chunk, and tells its state, within this time.
    pub answer: Duration,
    /// The longest pause between two questions. A contact in a move that should meet nothing must be a hold
    /// within `LATENCY_S` (planning, `turning.rs`).
    pub poll: Duration,
    /// A control that says it moves shows another position within this time.
    pub stall: Duration,
    /// The control's heartbeat changes within this time.
    pub heartbeat: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        Self {
            answer: Duration::from_secs(4),
            poll: Duration::from_millis(20),
            stall: Duration::from_secs(10),
            heartbeat: Duration::from_secs(2),
        }
    }
}
