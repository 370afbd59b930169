//! Effect of a CAN controller's error frame on a receiver of frames.

use socketcan::CanError;
use socketcan::errors::{ControllerProblems, ErrorCause};

/// Effect of one error frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum ErrorFrameEffect {
    /// A fault other than lost arbitration, such as a protocol violation or an error-passive controller, with its
    /// description. The sender repeats a disturbed frame.
    BusErrors(String),
    /// The controller is bus-off: it receives nothing until it is restarted.
    BusOff(String),
    /// The controller lost frames: its receive buffer overflowed, or it was restarted after bus-off.
    LostFrames,
    /// The error frame does not affect a receiver: lost arbitration, error counters, or the return to error-active.
    Harmless,
}

/// State that a controller reports after recovery: error-active.
const ERROR_ACTIVE: ControllerProblems = ControllerProblems::ACTIVE;

impl From<CanError> for ErrorFrameEffect {
    fn from(error: CanError) -> Self {
        let overflowed = |problems: ControllerProblems| problems.intersects(ControllerProblems::RX_OVERFLOW);
        if error.is_restarted() || error.controller().is_some_and(overflowed) {
            ErrorFrameEffect::LostFrames
        } else if error.is_bus_off() {
            Self::BusOff(error.to_string())
        } else if error.causes().any(is_receive_fault) {
            Self::BusErrors(error.to_string())
        } else {
            Self::Harmless
        }
    }
}

/// Whether the cause can disturb reception: every cause except lost arbitration, error counters and error-active.
fn is_receive_fault(cause: &ErrorCause) -> bool {
    match cause {
        ErrorCause::LostArbitration(_) | ErrorCause::Counters { .. } => false,
        ErrorCause::Controller(problems) => *problems != ERROR_ACTIVE,
        _ => true,
    }
}

#[cfg(test)]
mod tests {
    use socketcan::CanErrorFrame;

    use super::*;

    /// Makes an error frame; bits and bytes as in the kernel's `can/error.h`.
    fn classify_error_frame(class: u32, data: &[u8]) -> ErrorFrameEffect {
        CanErrorFrame::new_error(class, data).unwrap().into_error().into()
    }

    #[test]
    fn error_frames_are_classified_for_a_receiver() {
        // Bus error with a protocol violation (stuff error), as at a wrong bit rate.
        let ErrorFrameEffect::BusErrors(why) = classify_error_frame(0x88, &[0, 0, 0x04, 0, 0, 0, 0, 0]) else {
            panic!()
        };
        assert!(why.contains("bit stuffing error") && why.contains("bus error"), "{why}");
        // Error-passive, with the counters.
        let ErrorFrameEffect::BusErrors(why) = classify_error_frame(0x204, &[0, 0x10, 0, 0, 0, 0, 0, 128]) else {
            panic!()
        };
        assert!(why.contains("rx passive") && why.contains("rx=128"), "{why}");
        assert_eq!(classify_error_frame(0x40, &[]), ErrorFrameEffect::BusOff("bus off".to_owned()));
        assert_eq!(classify_error_frame(0x100, &[]), ErrorFrameEffect::LostFrames);
        assert_eq!(classify_error_frame(0x04, &[0, 0x01]), ErrorFrameEffect::LostFrames, "receive buffer overflow");
        // Return to error-active, counters alone, lost arbitration: no fault.
        assert_eq!(classify_error_frame(0x04, &[0, 0x40]), ErrorFrameEffect::Harmless);
        assert_eq!(classify_error_frame(0x200, &[0, 0, 0, 0, 0, 0, 3, 4]), ErrorFrameEffect::Harmless);
        assert_eq!(classify_error_frame(0x02, &[5]), ErrorFrameEffect::Harmless);
    }
}
