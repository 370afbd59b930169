//! Register addresses, as published.

use machine::{Axis, Position};

/// Sizes of the command block in holding registers: with lines, and with the table of a resident program.
pub(super) const OF_LINES: usize = 106;
pub(super) const OF_PROGRAM: usize = 334;
pub(super) const HOLD: usize = 0;
pub(super) const SEQUENCE: usize = 1;
pub(super) const HEARTBEAT: usize = 2;
pub(super) const ACKNOWLEDGE: usize = 3;
pub(super) const CRC: usize = 4;
pub(super) const LENGTH: usize = 5;
pub(super) const CHUNK: usize = 6;

pub(super) const AXES: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];

/// Positions in steps of 0.001 mm or degree, rounded as in a report with three decimals.
pub(super) fn steps(position: &Position) -> Vec<i32> {
    let step = |axis: Axis| format!("{:.3}", axis.to_edge(position.at(axis))).replace('.', "");
    AXES.map(|axis| step(axis).parse().unwrap_or(i32::MAX)).to_vec()
}
