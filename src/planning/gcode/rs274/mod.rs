//! Reader of RS274/NGC text (Kramer, Proctor, Messina: NISTIR 6556, section 3, as used by LinuxCNC and Grbl):
//! converts it back into motions. It accepts the contents of a measuring program: straight moves, probing moves,
//! dwells, spindle orientation, a stop for the operator, and conditions whose only effect is to stop. Everything
//! else is refused with its line: a word that is not understood is never skipped.

mod declared;
mod line;
mod state;

pub use self::declared::{Declared, Switch};
use self::line::Line;
use self::state::State;
use machine::Position;

/// A motion as read from the text.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadMotion {
    /// Line of the text, from 1.
    pub line: usize,
    /// Value of the N word.
    pub n: Option<u32>,
    pub kind: Kind,
    /// End positions of the axes in the line, mm and rad; empty for dwell, orientation and stop.
    pub target: Position,
    pub frame: Frame,
    /// Feed, mm/min; `None` for a rapid and for anything that does not move.
    pub feed_mm_min: Option<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    /// G0: rapid move.
    Rapid,
    /// G1: move at feed.
    Feed,
    /// G38.2 (`must_touch`: no contact is an alarm) or G38.3.
    Probe {
        must_touch: bool,
    },
    Dwell {
        seconds: f64,
    },
    /// M19: orientation of the spindle, rad.
    Orient {
        s: f64,
    },
    /// M0: waits for the operator.
    Stop,
}

/// Frame of the target.
#[derive(Debug, Clone, PartialEq)]
pub enum Frame {
    /// G53, or a work offset slot known to be zero, with G92 and tool length offset off.
    Machine,
    /// Work coordinates of this name; the text does not contain their offsets.
    Work(String),
}

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("line {line}: {why}")]
pub struct ReadError {
    pub line: usize,
    pub why: String,
}

/// Reads the motions of a program, in order.
///
/// `zero_slot` is a work offset slot (`G59.3`) known to hold zeros before the program starts. All other state is
/// unknown at the start and must be set by the text before it is used: units, distance mode, exact path (G61 or
/// G61.1) and feed per minute (G94) before any move, a feed before a feed move. M72 makes this state unknown again.
///
/// # Errors
/// The first line that is not understood, or that moves in a state not set.
pub fn read(text: &str, zero_slot: Option<&str>) -> Result<Vec<ReadMotion>, ReadError> {
    read_with(text, zero_slot, &Declared::default())
}

/// Like [`read`], on a machine with commands of its own. If a command switches the probe, the probe must be on
/// before a probing move; an axis with a clamp moves only while the clamp is open, and a probing move needs the
/// clamp closed.
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
