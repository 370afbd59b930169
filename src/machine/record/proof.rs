//! What the proof of a stage found.

use serde::{Deserialize, Serialize};

/// A stage that was proven.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Proof {
    /// Motions looked at.
    pub motions: usize,
    /// The smallest clearance of all moves that must stay free, between bodies of two sides of the
    /// machine; `None` if no such pair was looked at.
    pub nearest: Option<Clearance>,
    /// The smallest clearance of each step, in order.
    pub steps: Vec<Clearance>,
    /// In words: bodies that the machine file does not declare, neighbours that are built close, moves
    /// before it is known where all axes stand.
    pub not_looked_at: Vec<String>,
}

/// Two bodies, how near they come, and where.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Clearance {
    pub step: u32,
    /// Line of the stage's text, from 1.
    pub line: usize,
    pub clearance_mm: f64,
    /// e.g. `stylus stem` and `artefact`.
    pub between: [String; 2],
}
