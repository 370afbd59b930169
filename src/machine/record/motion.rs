//! Neutral motion: what a dialect renders and a controller executes. Machine coordinates.

use serde::{Deserialize, Serialize};

use super::track::Track;
use crate::Position;

/// One move. Only the axes named in `to` move; all of them together, along a straight line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "do")]
pub enum Motion {
    /// Fast, unguarded: only where nothing can be touched.
    Rapid {
        to: Position,
    },
    /// At feed, unguarded: the short retract out of contact; afterwards the probe must read open.
    BackOff {
        to: Position,
        feed_mm_min: f64,
    },
    /// At feed, unguarded: along a scan, and towards it. There is nothing that could be touched.
    Feed {
        to: Position,
        feed_mm_min: f64,
    },
    /// At feed, stops on contact; contact is a fault.
    Guarded {
        to: Position,
        feed_mm_min: f64,
    },
    /// The touch: stops on contact, which must come before `to`.
    Probe {
        to: Position,
        feed_mm_min: f64,
    },
    /// Turn the spindle to an orientation (rad) and hold it.
    Orient {
        s: f64,
    },
    Dwell {
        seconds: f64,
    },
}

/// The motions of one step, executed as one unit: at most one `Probe`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Block {
    pub step: u32,
    pub repeat: u32,
    pub motions: Vec<Motion>,
}

/// What a controller says of an executed block.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Outcome {
    /// All axis positions at the trigger, machine coordinates; `None` if the block has no `Probe`.
    pub touch: Option<Position>,
    /// Time of the trigger where the control stamps it, s; otherwise the host's clock is used.
    pub t_s: Option<f64>,
    /// Of a block that moves at feed, where the control stamps positions: all the while.
    pub track: Option<Track>,
}
