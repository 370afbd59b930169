//! Converts a control's messages, or its silence, to errors for the operator.

use std::time::Duration;

use super::message::{GrblMessage, GrblStatus, Overrides, error_meaning};
use crate::controllers::{ControllerError, ReadinessFinding};

pub(super) fn refusal_error(line: &str, code: u32) -> ControllerError {
    ControllerError::line_refused(line, format!("error:{code}"), error_meaning(code))
}

/// Error if the answering device is not a Grbl control, or if nothing answers.
pub(super) fn foreign_device_error(has_noise: bool, foreign_text: Option<String>, waited: Duration) -> ControllerError {
    if has_noise {
        return ControllerError::UnexpectedDevice {
            state: "the replies are unreadable bytes, probably at a wrong baud rate".to_owned(),
            remedy: "check baud in [controller] of the machine file".to_owned(),
        };
    }
    match foreign_text {
        Some(text) => ControllerError::UnexpectedDevice {
            state: format!("the reply is not from a Grbl control: `{text}`"),
            remedy: "check kind and the address in [controller] of the machine file".to_owned(),
        },
        None => ControllerError::no_answer("?", waited),
    }
}

/// Error for a control that answers but executes no motion in its present state.
pub(super) fn not_ready_error(status: &GrblStatus) -> ControllerError {
    // A held move continues when the hold is released: only a reset discards the move.
    let remedy = match status.state.as_str() {
        "Alarm" => {
            "inspect the machine, unlock the control ($X) and home the machine; without homing switches, jog each \
             axis to its end before $H"
        }
        "Hold" | "Tool" => "a move is held: reset the control, inspect the machine, home it",
        "Run" | "Jog" | "Home" => "wait until the machine is at rest, then start again",
        "Door" => "close the door, reset the control, inspect the machine, home it",
        "Check" => "end the check mode ($C)",
        "Sleep" => "wake the control with a reset",
        _ => "bring the control to the state Idle",
    };
    ControllerError::not_ready(state_text(status), remedy)
}

/// Finding for overrides other than 100 %: touches at another feed than the planned one have another latch delay and
/// overtravel.
pub(super) fn override_finding(now: Overrides) -> Option<ReadinessFinding> {
    let Overrides { feed_percent, rapid_percent } = now;
    (feed_percent != 100.0 || rapid_percent != 100.0).then(|| {
        ReadinessFinding::blocking(
            format!("the overrides are not 100 %: feed {feed_percent} %, rapid {rapid_percent} %"),
            "set both overrides to 100 % at the control, start again",
        )
    })
}

pub(super) fn state_text(status: &GrblStatus) -> String {
    match &status.substate {
        Some(substate) => format!("{}:{substate}", status.state),
        None => status.state.clone(),
    }
}

pub(super) fn unexpected_reply_error(reply: &GrblMessage) -> ControllerError {
    let reply = match reply {
        GrblMessage::Ok => "ok".to_owned(),
        GrblMessage::Error(code) => format!("error:{code}"),
        message => format!("{message:?}"),
    };
    ControllerError::UnexpectedReply { reply }
}

/// Whether the machine is certainly at rest after `error`; false if it may still move.
pub(super) fn is_at_rest_after(error: &ControllerError) -> bool {
    let is_reported_at_rest =
        matches!(error, ControllerError::ControlReset { .. } | ControllerError::TouchMismatch { .. });
    is_reported_at_rest || error.is_machine_stationary()
}
