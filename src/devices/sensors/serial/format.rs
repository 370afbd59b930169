//! Format of serial data: lines of text, or frames of bytes.

use super::{frame, line};

/// Format by which the byte stream is split into samples and decoded.
#[derive(Debug, Clone)]
pub(super) enum DataFormat {
    Line(line::LineFormat),
    Frame(frame::FrameFormat),
}

impl DataFormat {
    /// Number of samples after which the counter restarts, if there is one.
    pub fn counter_modulus(&self) -> Option<u64> {
        match self {
            Self::Line(layout) => layout.sample_layout.counter_modulus(),
            Self::Frame(layout) => layout.body_layout.sample_layout.counter_modulus(),
        }
    }

    /// Number of counts after which the encoder's count restarts, if a sample carries it.
    pub fn encoder_modulus(&self) -> Option<u64> {
        match self {
            Self::Line(layout) => layout.sample_layout.encoder_modulus(),
            Self::Frame(layout) => layout.body_layout.sample_layout.encoder_modulus(),
        }
    }

    /// Keys that determine how the stream is cut into lines or frames, with their values.
    pub fn framing_keys(&self) -> Vec<(&'static str, String)> {
        match self {
            Self::Line(layout) => layout.framing_keys().to_vec(),
            Self::Frame(layout) => layout.framing_keys().to_vec(),
        }
    }
}
