//! The two formats of serial data, and what they share.

use super::{frame, line};

/// Format by which the stream is cut and decoded.
#[derive(Debug, Clone)]
pub(super) enum Form {
    Line(line::Layout),
    Frame(frame::Layout),
}

impl Form {
    /// Number of samples after which the counter restarts, if there is one.
    pub fn round(&self) -> Option<u64> {
        match self {
            Self::Line(layout) => layout.round(),
            Self::Frame(layout) => layout.round(),
        }
    }

    /// Number of counts after which the encoder's count restarts, if a sample carries it.
    pub fn encoder_round(&self) -> Option<u64> {
        match self {
            Self::Line(layout) => layout.encoder_round(),
            Self::Frame(layout) => layout.encoder_round(),
        }
    }

    /// Keys that determine how the stream is cut into lines or frames, with their values.
    pub fn framing(&self) -> Vec<(&'static str, String)> {
        match self {
            Self::Line(layout) => layout.framing().to_vec(),
            Self::Frame(layout) => layout.framing().to_vec(),
        }
    }
}
