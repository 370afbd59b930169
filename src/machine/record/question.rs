//! What a person at the machine is asked while it is commissioned, and what may be answered. The
//! words belong to whoever asks.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::{Axis, Position};

/// A small straight move of one axis from where it stands.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Jog {
    pub axis: Axis,
    /// mm for X, Y and Z, degrees for the others; the sign is that of the command.
    pub by: f64,
    /// mm or degrees a minute.
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

/// How the stylus is to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stylus {
    /// The touch probe sits in the spindle, and no other sensor in its place.
    Mounted,
    /// Nobody and nothing touches it.
    Free,
    /// Pressed aside by hand, and held there.
    Deflected,
}

#[derive(Debug, Clone, PartialEq)]
pub enum Question {
    /// The control says that it stands here, machine coordinates. Does its own display show the same?
    /// Yes or no.
    Shows(Position),
    /// May the machine move so, and then back? `look_for`: what will be seen, in words. Yes or no.
    MayJog { jog: Jog, look_for: String },
    /// What was seen? `Saw`.
    Jogged { jog: Jog, look_for: String },
    /// Is the stylus so? Yes, once it is; no, if it cannot be.
    Stylus(Stylus),
    /// The probe reads closed at this position. Which linear axis leads the stylus out of contact?
    /// `Retract`; no: nothing moves.
    RetractDirection {
        position: Position,
        /// The visible motion of each axis at a positive command, in words.
        look_for: Vec<String>,
        /// Result of the last answer, if the probe still reads closed.
        last_result: Option<String>,
    },
    /// May the machine move so, to be held on its way? Yes or no.
    MayHold(Jog),
    /// The control was held. Is it released there, and ready again? `not_yet`: why it was not when it
    /// was last tried. Yes or no.
    Released { not_yet: Option<String> },
    /// May this be done? Yes or no.
    May { what: String },
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Answer {
    Yes,
    No,
    Saw(Seen),
    /// One step along this axis.
    Retract(AxisDirection),
    /// Nobody is there who could answer.
    Nobody,
}

/// What was seen of a jog.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Seen {
    AsSaid,
    /// As far as said, the other way.
    OtherWay,
    /// Nothing moved.
    Nothing,
    /// This axis moved instead.
    Another(Axis),
    /// The axis moved so far instead: mm or degrees, negative if it went the other way.
    Distance(f64),
    /// It was not seen well: once more.
    Again,
}
