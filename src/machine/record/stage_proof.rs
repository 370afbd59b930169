//! Result of the proof of a stage.

use serde::{Deserialize, Serialize};

/// Result of the collision proof of one stage.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct StageProof {
    /// Number of proven motions.
    #[serde(rename = "motions")]
    pub motion_count: usize,
    /// Smallest clearance of all moves that must stay free, between bodies of two sides of the machine; `None` if
    /// no such pair was checked.
    pub nearest: Option<Clearance>,
    /// The smallest clearance of each step, in order; a step in which no such pair was checked is missing.
    pub steps: Vec<Clearance>,
    /// What was not checked, as text: bodies that the machine file does not declare, pairs of bodies that are built
    /// close, moves before the positions of all axes are known.
    #[serde(rename = "not_looked_at")]
    pub unchecked_items: Vec<String>,
}

/// Two bodies, their smallest distance, and the line of the text.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Clearance {
    /// Id of the step.
    pub step: u32,
    /// Line of the stage's text, from 1.
    pub line: usize,
    /// Smallest distance, less the possible misplacement of a body. The true value may be smaller by up to 0.02 mm.
    pub clearance_mm: f64,
    /// e.g. `stylus stem` and `artefact`.
    pub between: [String; 2],
}
