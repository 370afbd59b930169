//! Dwell points and cells: where samples were taken, and their mean.

use nalgebra::{Rotation3, Vector3};

use super::label::Pass;
use machine::Position;

/// One place at which samples were taken, or one cell of a continuous scan: their mean.
#[derive(Debug, Clone, Copy)]
pub struct Spot {
    /// X, Y, Z.
    pub xyz: Vector3<f64>,
    /// The same as how far the spindle stands from the table, machine frame.
    pub at: Vector3<f64>,
    /// Reading.
    pub value: f64,
    pub samples: usize,
    pub t_s: f64,
    /// X, Y, Z in mm/s, and the sign of the last motion of each (0 where that is not known): means.
    pub velocity: Vector3<f64>,
    pub toward: Vector3<f64>,
}

/// One step's dwell points. The rotary axes stand.
#[derive(Debug, Clone)]
pub struct Scanned {
    pub pass: Pass,
    pub label: String,
    /// All rotary axes.
    pub rotary: Position,
    /// Spindle frame to machine frame.
    pub spindle: Rotation3<f64>,
    pub spots: Vec<Spot>,
}
