//! Reads RS274/NGC text (Kramer, Proctor, Messina: NISTIR 6556, section 3, as spoken by LinuxCNC
//! and Grbl) back into motions. It knows what a measuring program may say: straight moves, probe
//! moves, dwells, spindle orientation, a stop for a person, conditions that do nothing but stop. Whatever else stands
//! in a program is refused with its line: a word that is not understood is not skipped.

mod declared;
mod line;
mod state;

pub use self::declared::{Declared, Switch};
use self::line::Line;
use self::state::State;
use machine::Position;

/// A motion as the text says it.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadMotion {
    /// Line of the text, from 1.
    pub line: usize,
    /// The N word.
    pub n: Option<u32>,
    pub kind: Kind,
    /// Where the named axes end, mm and rad; empty for dwell, orientation and stop.
    pub target: Position,
    pub frame: Frame,
    /// mm/min; `None` for a rapid and for whatever does not move.
    pub feed_mm_min: Option<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    /// G0
    Rapid,
    /// G1
    Feed,
    /// G38.2 (`must_touch`: no contact is an alarm) or G38.3.
    Probe {
        must_touch: bool,
    },
    Dwell {
        seconds: f64,
    },
    /// M19, rad
    Orient {
        s: f64,
    },
    /// M0: it waits for a person.
    Stop,
}

/// What the target refers to.
#[derive(Debug, Clone, PartialEq)]
pub enum Frame {
    /// G53, or a work offset slot known to be zero with G92 and tool length offset off.
    Machine,
    /// The work coordinates named, whose offsets the text does not tell.
    Work(String),
}

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("line {line}: {why}")]
pub struct ReadError {
    pub line: usize,
    pub why: String,
}

/// The motions of a program, in order.
///
/// `zero_slot` is a work offset slot (`G59.3`) known to hold zeros before the program starts; other
/// state is unknown at the start and must be set by the text before it matters: units, distance mode,
/// exact path (G61 or G61.1) and feed per minute (G94) before any move, a feed before a feed move.
/// M72 makes it unknown again.
///
/// # Errors
/// The first line that is not understood, or that moves in a state not set.
pub fn read(text: &str, zero_slot: Option<&str>) -> Result<Vec<ReadMotion>, ReadError> {
    read_with(text, zero_slot, &Declared::default())
}

/// As [`read`], on a machine with words of its own. With a word for it, the probe must be switched
/// on before a probing move; an axis with a clamp moves only while it is open, and a probing move
/// needs it closed.
pub fn read_with(
    text: &str,
    zero_slot: Option<&str>,
    declared: &Declared,
) -> Result<Vec<ReadMotion>, ReadError> {
    let mut state = State::new(zero_slot, declared);
    let mut motions = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        let read = Line::parse(line).and_then(|line| state.apply(line));
        if let Some(step) = read.map_err(|why| ReadError { line: number, why })? {
            motions.push(ReadMotion { line: number, ..step });
        }
    }
    state.end().map_err(|why| ReadError { line: text.lines().count(), why })?;
    Ok(motions)
}
