//! Proven blocks for tests of drivers and controls, where no plan declares bodies.

use super::proven_blocks::{ProvenBlock, StageProofError, read_back_block};
use crate::gcode::{Dialect, DialectError, TransmissionForm};
use machine::record::motion::MotionBlock;
use machine::{Axis, Position};

/// The dialect of this name.
///
/// # Errors
/// An unknown name.
pub fn load_dialect(name: &str) -> Result<Dialect, DialectError> {
    Dialect::from_name(name)
}

/// Renders `block` for a machine with `axes` at an unknown position, and reads it back; the clearance of bodies is
/// not checked.
///
/// # Errors
/// The block cannot be rendered, or the text does not agree with its motions.
pub fn prove_block_text(
    block: &MotionBlock,
    axes: &[Axis],
    dialect: &Dialect,
    transmission: &TransmissionForm,
) -> Result<ProvenBlock, StageProofError> {
    prove_block_text_from(Position::new(), block, axes, dialect, transmission)
}

/// Like [`prove_block_text`], for a machine at `start_position`.
///
/// # Errors
/// The errors of [`prove_block_text`].
pub fn prove_block_text_from(
    start_position: Position,
    block: &MotionBlock,
    axes: &[Axis],
    dialect: &Dialect,
    transmission: &TransmissionForm,
) -> Result<ProvenBlock, StageProofError> {
    let sent = dialect.render_for_transmission(transmission, axes, std::slice::from_ref(block))?;
    read_back_block(block, start_position, dialect, transmission, sent)
}
