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
pub enum StylusState {
    /// The touch probe is in the spindle, and no other sensor in its place.
    Mounted,
    /// Nothing touches the stylus.
    Free,
    /// The stylus is deflected by hand, and held there.
    Deflected,
}

/// A question to the operator. The comment of each variant ends with the possible answers.
#[derive(Debug, Clone, PartialEq)]
pub enum OperatorQuestion {
    /// The control reports this position, machine coordinates. Does its own display show the same? Yes or no.
    DisplayedPosition(Position),
    /// May the machine make this move, and then move back? `visible_motion`: the visible motion, as text. Yes or no.
    AllowJog { jog: Jog, visible_motion: String },
    /// Which motion did the operator see? `Motion`.
    ObservedJog { jog: Jog, visible_motion: String },
    /// Is the stylus in this state? Yes, once it is; no, if it cannot be.
    StylusState(StylusState),
    /// The probe reads closed at this position. Which linear axis moves the stylus out of contact? `Retract`; no:
    /// nothing moves.
    RetractDirection {
        position: Position,
        /// The visible motion of each axis at a positive command, as text.
        visible_motions: Vec<String>,
        /// Result of the last answer, if the probe still reads closed.
        last_result: Option<String>,
    },
    /// May the machine make this move, during which the program holds it as a test? Yes or no.
    AllowJogWithHold(Jog),
    /// The control was held. Is the hold released at the control, and is the control ready again? `last_failure`: why
    /// the last attempt failed. Yes or no.
    HoldReleased { last_failure: Option<String> },
    /// May this action be done? Yes or no.
    AllowAction { action: String },
}

/// Answer of the operator.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum OperatorAnswer {
    Yes,
    No,
    Motion(ObservedMotion),
    /// One step along this axis.
    Retract(AxisDirection),
    /// No operator is available to answer.
    NoOperator,
}

/// Motion that the operator saw during a jog.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ObservedMotion {
    AsAnnounced,
    /// The announced distance, in the opposite direction.
    Opposite,
    /// Nothing moved.
    NoMotion,
    /// This axis moved instead.
    OtherAxis(Axis),
    /// The axis moved by this distance instead: mm or degrees, negative in the opposite direction.
    Distance(f64),
    /// The operator did not see the motion clearly: repeat the jog.
    Unclear,
}
