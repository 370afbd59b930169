//! A block as rows of a table: the content of the proven text as it was read back, and nothing else.

use crate::controllers::ControllerError;
use machine::record::motion::Motion;
use machine::{Axis, Position};
use planning::gcode::Transmission;
use planning::gcode::rs274::{Kind, ReadMotion};
use planning::proof::ProvenBlock;

/// Action of a row; the numbers are those of `docs/resident-program.md`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Does {
    Rapid = 1,
    Feed = 2,
    Guarded = 3,
    Touch = 4,
    Dwell = 5,
    Orient = 6,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Row {
    pub does: Does,
    /// End position of the axes that the row names, mm and rad.
    pub target: Position,
    /// Feed in mm/min, duration of a dwell in s, orientation in degrees; 0 for a rapid.
    pub value: f64,
    /// Whether the move should touch nothing: a contact during it is a fault. A back-off leads out of
    /// contact.
    pub is_free_move: bool,
}

/// Returns the rows of `block`: the motions as the proof has read them.
///
/// # Errors
/// The block differs from the proven one, or no row can express its text.
pub(super) fn of(block: &ProvenBlock) -> Result<Vec<Row>, ControllerError> {
    let step = block.step();
    if *block.transmission() != Transmission::Rows {
        return Err(ControllerError::Transmission { step });
    }
    let fault = |why: String| ControllerError::Render { step, why };
    let units = block.units()?.iter();
    let pairs = units.flat_map(|proven| proven.unit.motions.iter().zip(&proven.read));
    pairs.map(|(motion, read)| row(motion, read).map_err(fault)).collect()
}

/// Converts one motion. `motion` distinguishes a touch from a guarded move, which some languages write
/// alike; all else comes from the text.
fn row(motion: &Motion, read: &ReadMotion) -> Result<Row, String> {
    let feed = read.feed_mm_min;
    let (does, value) = match read.kind {
        Kind::Rapid => (Does::Rapid, Some(0.0)),
        Kind::Feed => (Does::Feed, feed),
        Kind::Probe { .. } if matches!(motion, Motion::Probe { .. }) => (Does::Touch, feed),
        Kind::Probe { .. } => (Does::Guarded, feed),
        Kind::Dwell { seconds } => (Does::Dwell, Some(seconds)),
        Kind::Orient { s } => (Does::Orient, Some(Axis::S.to_edge(s))),
        Kind::Stop => return Err(format!("line {} waits for a person", read.line)),
    };
    let value = value.ok_or_else(|| format!("line {} has no feed", read.line))?;
    let is_free_move = matches!(motion, Motion::Rapid { .. } | Motion::Feed { .. });
    Ok(Row { does, target: read.target.clone(), value, is_free_move })
}

/// Position of the machine after `rows`, if it was at `from` and each touch met its contact. Axes that a
/// touch moved last are left out: their position is unknown.
pub(super) fn end(rows: &[Row], from: &Position) -> Position {
    rows.iter().fold(from.clone(), |stands, row| match row.does {
        Does::Touch => stands.only(|axis| {
            let moves = row.target.get(axis).is_some_and(|to| to != stands.at(axis));
            !moves
        }),
        _ => stands.updated_by(&row.target),
    })
}
