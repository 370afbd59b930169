//! A block as rows of a table: the content of the proven text as it was read back, and nothing else.

use crate::controllers::ControllerError;
use machine::record::motion::Motion;
use machine::{Axis, Position};
use planning::gcode::TransmissionForm;
use planning::gcode::rs274::{MotionKind, ReadMotion};
use planning::proof::ProvenBlock;

/// Action of a row; the numbers are those of `docs/resident-program.md`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RowAction {
    Rapid = 1,
    /// Feed move that does not stop at a contact; also a back-off.
    Feed = 2,
    /// Stops at a contact, which is a fault.
    Guarded = 3,
    /// Stops at a contact, which is the result; no contact is a fault.
    Touch = 4,
    Dwell = 5,
    OrientSpindle = 6,
}

/// One row of the table that a resident program executes: one motion.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ProgramRow {
    pub action: RowAction,
    /// End position of the axes that the row names, mm and rad.
    pub target: Position,
    /// Feed in mm/min, duration of a dwell in s, orientation of the spindle in degrees; 0 for a rapid.
    pub feed_dwell_or_angle: f64,
    /// Whether a contact during the move is a fault: `true` for rapid and feed moves. A guarded move reports its own
    /// contact; a back-off begins in contact.
    pub is_positioning_move: bool,
}

/// Returns the rows of `block`: the motions as the proof has read them.
///
/// # Errors
/// The block differs from the proven one, or no row can express its text.
pub(super) fn rows_from_block(block: &ProvenBlock) -> Result<Vec<ProgramRow>, ControllerError> {
    let step = block.step();
    if *block.transmission() != TransmissionForm::TableRows {
        return Err(ControllerError::WrongTransmission { step });
    }
    let fault = |reason: String| ControllerError::RenderFailed { step, reason };
    let units = block.units()?.iter();
    let pairs = units.flat_map(|proven| proven.unit.motions.iter().zip(&proven.read_motions));
    pairs.map(|(motion, read)| row_from_motion(motion, read).map_err(fault)).collect()
}

/// Converts one motion. `motion` distinguishes a touch from a guarded move, which some languages write
/// alike; all else comes from the text.
fn row_from_motion(motion: &Motion, read: &ReadMotion) -> Result<ProgramRow, String> {
    let feed = read.feed_mm_min;
    let (action, value) = match read.kind {
        MotionKind::Rapid => (RowAction::Rapid, Some(0.0)),
        MotionKind::Feed => (RowAction::Feed, feed),
        MotionKind::Probe { .. } if matches!(motion, Motion::Probe { .. }) => (RowAction::Touch, feed),
        MotionKind::Probe { .. } => (RowAction::Guarded, feed),
        MotionKind::Dwell { seconds } => (RowAction::Dwell, Some(seconds)),
        MotionKind::OrientSpindle { s } => (RowAction::OrientSpindle, Some(Axis::S.to_mm_or_deg(s))),
        MotionKind::ProgramStop => return Err(format!("line {} waits for the operator", read.line)),
    };
    let feed_dwell_or_angle = value.ok_or_else(|| format!("line {} has no feed", read.line))?;
    let is_positioning_move = matches!(motion, Motion::Rapid { .. } | Motion::Feed { .. });
    Ok(ProgramRow { action, target: read.target.clone(), feed_dwell_or_angle, is_positioning_move })
}

/// Position of the machine after `rows`, if it was at `from` and each touch met its contact. Axes that a
/// touch moved last are left out: their position is unknown.
pub(super) fn end_position(rows: &[ProgramRow], from: &Position) -> Position {
    rows.iter().fold(from.clone(), |position, row| match row.action {
        RowAction::Touch => position.filter_axes(|axis| {
            let moves = row.target.get(axis).is_some_and(|to| to != position.get_or_zero(axis));
            !moves
        }),
        _ => position.updated_by(&row.target),
    })
}
