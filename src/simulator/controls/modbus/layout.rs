//! Register addresses, as published in `docs/line-window.md` and `docs/resident-program.md`.

use machine::{Axis, Position};

/// Sizes of the command block in holding registers: with lines, and with the table of a resident program.
pub(super) const LINE_COMMAND_BLOCK_REGISTER_COUNT: usize = 106;
pub(super) const PROGRAM_COMMAND_BLOCK_REGISTER_COUNT: usize = 334;
pub(super) const HOLD_REGISTER: usize = 0;
pub(super) const SEQUENCE_REGISTER: usize = 1;
pub(super) const HEARTBEAT_REGISTER: usize = 2;
pub(super) const ACKNOWLEDGE_REGISTER: usize = 3;
pub(super) const CRC_REGISTER: usize = 4;
pub(super) const LENGTH_REGISTER: usize = 5;
pub(super) const CHUNK_REGISTER: usize = 6;

pub(super) const REGISTER_AXES: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];

/// Positions in steps of 0.001 mm or degree, rounded as in a report with three decimals.
pub(super) fn position_steps(position: &Position) -> Vec<i32> {
    let step = |axis: Axis| format!("{:.3}", axis.to_mm_or_deg(position.get_or_zero(axis))).replace('.', "");
    REGISTER_AXES.map(|axis| step(axis).parse().unwrap_or(i32::MAX)).to_vec()
}

/// Registers of `bytes`, most significant byte first.
pub(super) fn register_words(bytes: &[u8]) -> Vec<u16> {
    bytes.chunks(2).map(|pair| pair.iter().fold(0, |word, byte| word << 8 | u16::from(*byte))).collect()
}
