//! What a person at the machine is asked while it is commissioned, and what may be answered. The
//! words belong to whoever asks.

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
