//! Reader of RS274/NGC text (Kramer, Proctor, Messina: NISTIR 6556, section 3, as used by LinuxCNC and Grbl):
//! converts it back into motions. It accepts the contents of a measuring program: straight moves, probing moves,
//! dwells, spindle orientation, a stop for the operator, and conditions whose only effect is to stop. Everything
//! else is refused with its line: a word that is not understood is never skipped.

mod declared_commands;
mod gcode_line;
mod reader_state;

pub use self::declared_commands::{DeclaredCommands, SwitchEffect, check_kinematics_command};
use self::gcode_line::GcodeLine;
use self::reader_state::GcodeReaderState;
use machine::Position;
use std::borrow::Cow;

/// A motion as read from the text.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadMotion {
    /// Line of the text, from 1.
    pub line: usize,
    /// Value of the N word; `None`: the line has no N word.
    pub step_number: Option<u32>,
    pub kind: MotionKind,
    /// End positions of the axes in the line, mm and rad, absolute also for G91; empty for dwell, orientation and
    /// stop.
    pub target: Position,
    pub frame: MotionFrame,
    /// Feed, mm/min, or degrees/min if only rotary axes move; `None` for a rapid and for anything that does not move.
    pub feed_mm_min: Option<f64>,
}

/// Kind of a motion, by its G or M word.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MotionKind {
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
    OrientSpindle {
        s: f64,
    },
    /// M0: waits for the operator.
    ProgramStop,
}

/// Frame of the target.
#[derive(Debug, Clone, PartialEq)]
pub enum MotionFrame {
    /// G53, or a work offset slot known to be zero, with G92 and tool length offset off.
    Machine,
    /// Work coordinates: name of the slot (`G54`), or `an unknown work offset`; the text does not contain their
    /// offsets.
    Work(String),
}

/// Error: the G-code reader refuses a line of the program.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("line {line}: {reason}")]
pub struct ReadError {
    /// Line of the text, from 1.
    pub line: usize,
    pub reason: LineError,
}

/// Reason why a line is refused, worded so that a message can print it after the text of the line.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct LineError(Cow<'static, str>);

impl<T: Into<Cow<'static, str>>> From<T> for LineError {
    fn from(text: T) -> Self {
        Self(text.into())
    }
}

/// Reads the motions of a program, in order. A dwell without an N word and the declared commands are not returned.
///
/// `zero_offset_slot` is a work offset slot (`G59.3`) known to hold zeros before the program starts. All other state is
/// unknown at the start and must be set by the text before it is used: units, distance mode, exact path (G61 or
/// G61.1) and feed per minute (G94) before any move, a feed before a feed move. M72 makes this state unknown again.
///
/// `declared` are the machine's own commands. If a command switches the probe, the probe must be on before a probing
/// move; an axis with a clamp moves only while the clamp is open, and a probing move needs the clamp closed.
///
/// # Errors
/// The first line that is not understood, or that moves before the text has set the required state.
pub fn read_program(
    text: &str,
    zero_offset_slot: Option<&str>,
    declared: &DeclaredCommands,
) -> Result<Vec<ReadMotion>, ReadError> {
    let mut state = GcodeReaderState::new(zero_offset_slot, declared);
    let mut motions = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        let read = GcodeLine::parse(line).and_then(|line| state.apply_line(line));
        if let Some(step) = read.map_err(|reason| ReadError { line: number, reason })? {
            motions.push(ReadMotion { line: number, ..step });
        }
    }
    state.check_no_open_condition().map_err(|reason| ReadError { line: text.lines().count(), reason })?;
    Ok(motions)
}
