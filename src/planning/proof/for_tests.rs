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
    without_bodies(block, Position::new(), axes, dialect, transmission)
}
