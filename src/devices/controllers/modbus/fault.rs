//! Converts a control's reports, or its silence, to errors for the operator.

use std::time::Duration;

use super::status::{State, Status};
use crate::controllers::ControllerError;
use link::modbus::ModbusError;

/// Alarm code: the probe was closed before a probing move.
pub(super) const PROBE_CLOSED: u16 = 4;
/// Alarm code of a resident program: the probe did not come free after the back-off.
pub(super) const STILL_CLOSED: u16 = 11;
/// Alarm code of a hold because trued's heartbeat stopped.
const HEARTBEAT_LOST: u16 = 64;

/// Meaning of an alarm code; the codes are those of Grbl if Grbl has the alarm.
fn alarm_meaning(code: u16) -> &'static str {
    match code {
        1 => "a hard limit, or a drive that stalled",
        2 => "a target beyond the soft limits",
        3 => "the control was reset in motion",
        PROBE_CLOSED => "the probe was closed before a probing move",
        5 => "a probing move without contact",
        6..=9 => "homing failed",
        10 => "emergency stop",
        STILL_CLOSED => "the probe stays closed after the back-off",
        HEARTBEAT_LOST => "trued's heartbeat stopped",
        _ => "see the control's own list of alarms",
    }
}

fn refusal_meaning(error: u16) -> &'static str {
    match error {
        1 => "the length does not fit the window",
        2 => "the check sum does not fit what came",
        3 => "the control does not understand the text, or cannot do a row",
        4 => "it was not told that its last result was read: somebody else writes to it",
        5 => "trued's heartbeat is too old",
        6 => "the control is busy, held or in alarm",
        7 => "there is no such program",
        8 => "another tool is in the spindle",
        _ => "see the control's own list of refusals",
    }
}

pub(super) fn refused(line: &str, error: u16) -> ControllerError {
    ControllerError::Refused {
        line: line.to_owned(),
        reply: format!("error {error}"),
        meaning: refusal_meaning(error).to_owned(),
    }
}

pub(super) fn silent(line: &str, waited: Duration) -> ControllerError {
    ControllerError::NoAnswer { line: line.to_owned(), seconds: waited.as_secs_f64() }
}

pub(super) fn out_of_step(status: &Status, sequence: u16) -> ControllerError {
    let Status { accepted, executed, .. } = status;
    let heard = format!("accepted {accepted}, executed {executed} where {sequence} was last");
    ControllerError::OutOfStep { heard }
}

pub(super) fn reset() -> ControllerError {
    ControllerError::Reset { banner: "its sequence begins again".to_owned() }
}

/// Returns an error for a state that the run has not commanded.
pub(super) fn ends_it(status: &Status) -> Result<(), ControllerError> {
    match status.state {
        State::Idle | State::Running => Ok(()),
        State::NotReady => Err(ControllerError::Reset { banner: "it is not ready".to_owned() }),
        State::Held if status.alarm == HEARTBEAT_LOST => Err(ControllerError::HeldThere {
            state: "held, because the heartbeat from here stopped".to_owned(),
        }),
        State::Held => Err(ControllerError::HeldThere { state: "held".to_owned() }),
        State::Alarm => Err(ControllerError::Alarm {
            code: u32::from(status.alarm),
            meaning: alarm_meaning(status.alarm).to_owned(),
        }),
    }
}

/// Error for a control that answers but will not move in its present state; `None` if it is idle.
pub(super) fn not_ready(status: &Status) -> Option<ControllerError> {
    let (state, remedy) = match status.state {
        State::Idle => return None,
        State::Running => ("it is running", "wait until the machine stands, then start again"),
        State::NotReady => ("it is not ready", "switch it on, home it if it asks, make it ready"),
        State::Held => ("it is held", "look at the machine, then reset the hold at the control"),
        State::Alarm => {
            let state = format!("alarm {}: {}", status.alarm, alarm_meaning(status.alarm));
            let remedy = "look at the machine, clear the alarm at the control, home it if it asks";
            return Some(ControllerError::NotReady { state, remedy: remedy.to_owned() });
        }
    };
    Some(ControllerError::NotReady { state: state.to_owned(), remedy: remedy.to_owned() })
}

/// Checks that the probe is open before the first motion.
pub(super) fn probe_open(status: &Status) -> Result<(), ControllerError> {
    if status.probe_closed { Err(ControllerError::ProbeClosed) } else { Ok(()) }
}

/// Whether a fault of the wire may be absent when the request is repeated: nothing shows that the
/// connection or the device is faulty. Codes 5 and 6: the device needs more time.
pub(super) fn may_pass(error: &ModbusError) -> bool {
    match error {
        ModbusError::NotReadBack { source, .. } => may_pass(source),
        ModbusError::Late { .. } | ModbusError::Misfit { .. } | ModbusError::Unclear { .. } => true,
        ModbusError::Refused { code, .. } => matches!(code, 5 | 6),
        _ => false,
    }
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
            | E::NoContact { .. }
            | E::UnexpectedContact { .. }
            | E::StillTripped { .. }
            | E::WrongPosition { .. }
            | E::NotReady { .. }
            | E::UnexpectedDevice { .. }
            | E::Stamp { .. }
            | E::Probe { .. }
            | E::Render { .. }
    )
}
