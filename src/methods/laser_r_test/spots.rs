//! Dwell points and cells: where samples were taken, and their mean.

use glam::{DMat3, DVec3};

use super::label::Pass;
use machine::Position;

/// One place at which samples were taken, or one cell of a continuous scan: their mean.
#[derive(Debug, Clone, Copy)]
pub struct Spot {
    /// X, Y, Z.
    pub xyz: DVec3,
    /// The same as how far the spindle stands from the table, machine frame.
    pub at: DVec3,
    /// Reading.
    pub value: f64,
    pub samples: usize,
    pub t_s: f64,
    /// X, Y, Z in mm/s, and the sign of the last motion of each (0 where that is not known): means.
    pub velocity: DVec3,
    pub toward: DVec3,
}

/// One step's dwell points. The rotary axes stand.
#[derive(Debug, Clone)]
pub struct Scanned {
    pub pass: Pass,
    pub label: String,
    /// All rotary axes.
    pub rotary: Position,
    /// Spindle frame to machine frame.
    pub spindle: DMat3,
    pub spots: Vec<Spot>,
}
