//! What the two forms share.

use super::{frame, line};

/// How what comes is cut and understood.
#[derive(Debug, Clone)]
pub(super) enum Form {
    Line(line::Layout),
    Frame(frame::Layout),
}

impl Form {
    /// After how many samples the counter begins anew, if there is one.
    pub fn round(&self) -> Option<u64> {
        match self {
            Self::Line(layout) => layout.round(),
            Self::Frame(layout) => layout.round(),
        }
    }

    /// After how many counts the encoder's count begins anew, if a sample carries it.
    pub fn encoder_round(&self) -> Option<u64> {
        match self {
            Self::Line(layout) => layout.encoder_round(),
            Self::Frame(layout) => layout.encoder_round(),
        }
    }

    /// The keys by which what comes is cut into lines or frames, with their values.
    pub fn framing(&self) -> Vec<(&'static str, String)> {
        match self {
            Self::Line(layout) => layout.framing().to_vec(),
            Self::Frame(layout) => layout.framing().to_vec(),
        }
    }
}
