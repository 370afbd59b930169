//! Converts a control's messages, or its silence, to errors for the operator.

use std::time::Duration;

use super::message::{Message, Overrides, Status, error_meaning};
use crate::controllers::{ControllerError, ReadinessFinding};

pub(super) fn refused(line: &str, code: u32) -> ControllerError {
    ControllerError::Refused {
        line: line.to_owned(),
        reply: format!("error:{code}"),
        meaning: error_meaning(code).to_owned(),
    }
}

pub(super) fn silent(line: &str, waited: Duration) -> ControllerError {
    ControllerError::NoAnswer { line: line.to_owned(), seconds: waited.as_secs_f64() }
}

/// Error if the answering device is not a Grbl control, or if nothing answers.
pub(super) fn port_scan(noise: bool, foreign: Option<String>, waited: Duration) -> ControllerError {
    if noise {
        return ControllerError::UnexpectedDevice {
            state: "it answers with unreadable bytes, probably at the wrong speed".to_owned(),
            remedy: "check baud in [controller] of the machine file".to_owned(),
        };
    }
    match foreign {
        Some(text) => ControllerError::UnexpectedDevice {
            state: format!("it does not answer as Grbl does: `{text}`"),
            remedy: "check kind and the address in [controller] of the machine file".to_owned(),
        },
        None => silent("?", waited),
    }
}

/// Error for a control that answers but will not move in its present state.
pub(super) fn not_ready(status: &Status) -> ControllerError {
    // A held move continues when it is released: only a reset discards it.
    let remedy = match status.state.as_str() {
        "Alarm" => {
            "look at the machine, unlock it ($X) and home it at the control; without homing switches jog each \
             axis to its end before $H"
        }
        "Hold" | "Tool" => "a move is held: reset the control, look at the machine, home it",
        "Run" | "Jog" | "Home" => "wait until the machine stands, then start again",
        "Door" => "close the door, reset the control, look at the machine, home it",
        "Check" => "leave the check mode ($C)",
        "Sleep" => "wake the control with a reset",
        _ => "bring the control to Idle",
    };
    ControllerError::NotReady { state: state_of(status), remedy: remedy.to_owned() }
}

/// Touches at another feed than the planned one have another latch delay and overtravel.
pub(super) fn overridden(now: Overrides) -> Option<ReadinessFinding> {
    let Overrides { feed, rapid } = now;
    (feed != 100.0 || rapid != 100.0).then(|| {
        ReadinessFinding::hinders(
            format!("its overrides are not 100 %: feed {feed} %, rapid {rapid} %"),
            "set both overrides to 100 % at the control, start again",
        )
    })
}

pub(super) fn state_of(status: &Status) -> String {
    match &status.substate {
        Some(substate) => format!("{}:{substate}", status.state),
        None => status.state.clone(),
    }
}

pub(super) fn out_of_step(heard: &Message) -> ControllerError {
    let heard = match heard {
        Message::Ok => "ok".to_owned(),
        Message::Error(code) => format!("error:{code}"),
        other => format!("{other:?}"),
    };
    ControllerError::OutOfStep { heard }
}

/// Whether the machine is at rest after `error`: the control reports the fault at a standstill, or a hold
/// was sent.
pub(super) fn is_at_rest_after(error: &ControllerError) -> bool {
    use ControllerError as E;
    matches!(
        error,
        E::Halted
            | E::HeldThere { .. }
            | E::Alarm { .. }
            | E::Reset { .. }
            | E::NoContact { .. }
            | E::UnexpectedContact { .. }
            | E::StillTripped { .. }
            | E::WrongPosition { .. }
            | E::ContradictoryTouch { .. }
            | E::NotReady { .. }
            | E::UnexpectedDevice { .. }
            | E::Stamp { .. }
            | E::Probe { .. }
            | E::Render { .. }
    )
}
