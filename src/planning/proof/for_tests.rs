//! Blocks for tests of drivers and controls, where no plan says what must not meet.

use super::proven::{ProvenBlock, Unproven, without_bodies};
use crate::gcode::{Dialect, DialectError, Transmission};
use machine::record::motion::Block;
use machine::{Axis, Position};

/// The dialect of this name.
///
/// # Errors
/// An unknown name.
pub fn dialect(name: &str) -> Result<Dialect, DialectError> {
    Dialect::named(name)
}

/// `block` as it is sent to a machine with `axes`, from wherever it stands: rendered and read back, but no
/// bodies are looked at.
///
/// # Errors
/// What cannot be written, or reads otherwise than it was meant.
pub fn proven_block(
    block: &Block,
    axes: &[Axis],
    dialect: &Dialect,
    transmission: &Transmission,
) -> Result<ProvenBlock, Unproven> {
    proven_block_from(Position::new(), block, axes, dialect, transmission)
}

/// As [`proven_block`], from where the machine must stand.
///
/// # Errors
/// As [`proven_block`].
pub fn proven_block_from(
    begins: Position,
    block: &Block,
    axes: &[Axis],
    dialect: &Dialect,
    transmission: &Transmission,
) -> Result<ProvenBlock, Unproven> {
    without_bodies(block, begins, axes, dialect, transmission)
}
