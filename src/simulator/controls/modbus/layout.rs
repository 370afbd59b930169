//! Register addresses, as published in `docs/line-window.md` and `docs/resident-program.md`.

use machine::{Axis, Position};

/// Size of the command block in holding registers for a control that executes lines.
pub(super) const LINE_COMMAND_BLOCK_REGISTER_COUNT: usize = 106;
/// Size of the command block in holding registers for a control with a resident program.
pub(super) const PROGRAM_COMMAND_BLOCK_REGISTER_COUNT: usize = 334;
/// A value other than 0 holds the machine.
pub(super) const HOLD_REGISTER: usize = 0;
/// Number of the chunk; its write offers the chunk.
pub(super) const SEQUENCE_REGISTER: usize = 1;
/// The client's heartbeat: the value must change within the timeout.
pub(super) const HEARTBEAT_REGISTER: usize = 2;
/// Number of the chunk, or with a resident program of the result, that the client acknowledges.
pub(super) const ACKNOWLEDGE_REGISTER: usize = 3;
/// CRC-16/MODBUS of the bytes of the chunk.
pub(super) const CRC_REGISTER: usize = 4;
/// Length of the chunk in bytes.
pub(super) const LENGTH_REGISTER: usize = 5;
/// First register of the chunk, which extends to the end of the command block.
pub(super) const CHUNK_REGISTER: usize = 6;

/// Axes in the order in which registers contain their positions.
pub(super) const REGISTER_AXES: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];

/// Positions in steps of 0.001 mm or degree, in the order of `REGISTER_AXES`, rounded as in a report with three
/// decimals.
pub(super) fn position_steps(position: &Position) -> Vec<i32> {
    let step = |axis: Axis| format!("{:.3}", axis.to_mm_or_deg(position.get_or_zero(axis))).replace('.', "");
    REGISTER_AXES.map(|axis| step(axis).parse().unwrap_or(i32::MAX)).to_vec()
}

/// Registers of `bytes`, most significant byte first.
pub(super) fn register_words(bytes: &[u8]) -> Vec<u16> {
    bytes.chunks(2).map(|pair| pair.iter().fold(0, |word, byte| word << 8 | u16::from(*byte))).collect()
}
