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
}
