//! Questions to the operator during commissioning, and the possible answers. The user interface supplies the
//! wording.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::{Axis, Position};

/// A small straight move of one axis from its present position.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Jog {
    pub axis: Axis,
    /// Distance, mm for X, Y and Z, degrees for the others; the sign is that of the command.
    pub by: f64,
    /// Feed, mm/min or degrees/min.
    pub feed_per_min: f64,
}

/// An axis and the sign of its command, written `Z+`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AxisDirection {
    pub axis: Axis,
    pub is_positive: bool,
}

impl fmt::Display for AxisDirection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.axis, if self.is_positive { '+' } else { '-' })
    }
}

/// Required state of the stylus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stylus {
    /// The touch probe is in the spindle, and no other sensor in its place.
    Mounted,
    /// Nothing touches the stylus.
    Free,
    /// The stylus is deflected by hand, and held there.
    Deflected,
}

#[derive(Debug, Clone, PartialEq)]
pub enum Question {
    /// The control reports this position, machine coordinates. Does its own display show the same? Yes or no.
    Shows(Position),
    /// May the machine make this move, and then move back? `look_for`: the visible motion, as text. Yes or no.
    MayJog { jog: Jog, look_for: String },
    /// Which motion did the operator see? `Saw`.
    Jogged { jog: Jog, look_for: String },
    /// Is the stylus in this state? Yes, once it is; no, if it cannot be.
    Stylus(Stylus),
    /// The probe reads closed at this position. Which linear axis moves the stylus out of contact? `Retract`; no:
    /// nothing moves.
    RetractDirection {
        position: Position,
        /// The visible motion of each axis at a positive command, as text.
        look_for: Vec<String>,
        /// Result of the last answer, if the probe still reads closed.
        last_result: Option<String>,
    },
    /// May the machine make this move, to be held during the motion? Yes or no.
    MayHold(Jog),
    /// The control was held. Is the hold released at the control, and is the control ready again? `not_yet`: why
    /// the last attempt failed. Yes or no.
    Released { not_yet: Option<String> },
    /// May this action be done? Yes or no.
    May { what: String },
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Answer {
    Yes,
    No,
    Saw(Seen),
    /// One step along this axis.
    Retract(AxisDirection),
    /// No operator is available to answer.
    Nobody,
}

/// Motion that the operator saw during a jog.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Seen {
    AsSaid,
    /// The announced distance, in the opposite direction.
    OtherWay,
    /// Nothing moved.
    Nothing,
    /// This axis moved instead.
    Another(Axis),
    /// The axis moved by this distance instead: mm or degrees, negative in the opposite direction.
    Distance(f64),
    /// The operator did not see the motion clearly: repeat the jog.
    ResumableRun,
}
