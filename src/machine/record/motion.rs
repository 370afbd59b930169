//! Neutral motions, which a dialect renders and a controller executes. Machine coordinates.

use serde::{Deserialize, Serialize};

use super::axis_track::AxisTrack;
use crate::Position;

/// One move. Only the axes contained in `to` move, all together along a straight line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "do")]
pub enum Motion {
    /// Rapid move without contact detection: only where nothing can be touched.
    Rapid {
        to: Position,
    },
    /// Move at feed without contact detection: the short retract out of contact; afterwards the probe must read
    /// open.
    BackOff {
        to: Position,
        feed_mm_min: f64,
    },
    /// Move at feed without contact detection: along a scan and towards it, where nothing can be touched. If only
    /// rotary axes move, the feed is in degrees per minute.
    Feed {
        to: Position,
        feed_mm_min: f64,
    },
    /// Move at feed that stops on contact; contact is a fault.
    Guarded {
        to: Position,
        feed_mm_min: f64,
    },
    /// Probing move: stops on contact, which must occur before `to`.
    Probe {
        to: Position,
        feed_mm_min: f64,
    },
    /// Turns the spindle to an orientation (rad) and holds it.
    #[serde(rename = "orient")]
    OrientSpindle {
        s: f64,
    },
    Dwell {
        seconds: f64,
    },
}

/// Motions of one step, or of a part of it, executed as one unit: at most one `Probe`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MotionBlock {
    /// Id of the step.
    pub step: u32,
    /// Pass, coded as in `Stage::repeat` of the plan.
    pub repeat: u32,
    pub motions: Vec<Motion>,
}

/// Result of an executed block.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MotionBlockOutcome {
    /// All axis positions at the trigger, machine coordinates; `None` if the block has no `Probe`.
    pub trigger_position: Option<Position>,
    /// Time of the trigger, s, if the control stamps it; otherwise the host's clock is used.
    pub trigger_time_s: Option<f64>,
    /// For a block that moves at feed, on a control that stamps positions: the positions during the whole block.
    pub track: Option<AxisTrack>,
}
