//! Converts a control's reports, or its silence, to errors for the operator.

use super::status::{WindowState, WindowStatus};
use crate::controllers::ControllerError;
use link::modbus::ModbusError;

/// Alarm code: the probe was closed before a probing move.
pub(super) const ALARM_PROBE_CLOSED: u16 = 4;
/// Alarm code of a resident program: the probe did not come free after the back-off.
pub(super) const ALARM_PROBE_STILL_CLOSED: u16 = 11;
/// Alarm code of a hold because trued's heartbeat stopped.
const ALARM_HEARTBEAT_LOST: u16 = 64;

/// Meaning of an alarm code; the codes are those of Grbl if Grbl has the alarm.
fn alarm_meaning(code: u16) -> &'static str {
    match code {
        1 => "a hard limit, or a drive that stalled",
        2 => "a target beyond the soft limits",
        3 => "the control was reset in motion",
        ALARM_PROBE_CLOSED => "the probe was closed before a probing move",
        5 => "a probing move without contact",
        6..=9 => "homing failed",
        10 => "emergency stop",
        ALARM_PROBE_STILL_CLOSED => "the probe stays closed after the back-off",
        ALARM_HEARTBEAT_LOST => "trued's heartbeat stopped",
        _ => "unknown code; see the control's list of alarms",
    }
}

/// Meaning of the code with which the control refuses a chunk.
fn refusal_meaning(error: u16) -> &'static str {
    match error {
        1 => "the length does not fit the window",
        2 => "the checksum does not match the received data",
        3 => "the control cannot interpret the text, or cannot execute a row",
        4 => "the last result was not acknowledged: another client writes to the control",
        5 => "trued's heartbeat is too old",
        6 => "the control is busy, held or in alarm",
        7 => "the program number is unknown",
        8 => "another tool is in the spindle",
        _ => "unknown code; see the control's list of refusals",
    }
}

/// Error of a refused chunk: `line` identifies the chunk, `error` is the refusal code.
pub(super) fn refusal_error(line: &str, error: u16) -> ControllerError {
    ControllerError::line_refused(line, format!("error {error}"), refusal_meaning(error))
}

/// Error of a status whose sequence numbers do not fit the expected number `sequence`.
pub(super) fn unexpected_sequence_error(status: &WindowStatus, sequence: u16) -> ControllerError {
    let WindowStatus { checked_sequence, executed_sequence, .. } = status;
    let reply = format!("accepted {checked_sequence}, executed {executed_sequence}, expected {sequence}");
    ControllerError::UnexpectedReply { reply }
}

/// Error of a control that has restarted: no chunk is checked any more.
pub(super) fn reset_error() -> ControllerError {
    ControllerError::ControlReset { banner: "the sequence numbers start again".to_owned() }
}

/// Returns an error if the control is neither idle nor running.
pub(super) fn check_idle_or_running(status: &WindowStatus) -> Result<(), ControllerError> {
    match status.state {
        WindowState::Idle | WindowState::Running => Ok(()),
        WindowState::NotReady => Err(ControllerError::ControlReset { banner: "the control is not ready".to_owned() }),
        WindowState::Held if status.alarm_code == ALARM_HEARTBEAT_LOST => {
            Err(ControllerError::HeldAtControl { state: "held because the heartbeat of trued stopped".to_owned() })
        }
        WindowState::Held => Err(ControllerError::HeldAtControl { state: "held".to_owned() }),
        WindowState::Alarm => Err(ControllerError::Alarm {
            code: u32::from(status.alarm_code),
            meaning: alarm_meaning(status.alarm_code).to_owned(),
        }),
    }
}

/// Error for a control that answers but will not move in its present state; `None` if it is idle.
pub(super) fn not_ready_error(status: &WindowStatus) -> Option<ControllerError> {
    let (state, remedy) = match status.state {
        WindowState::Idle => return None,
        WindowState::Running => ("the machine is running", "wait until the machine is at rest, then start again"),
        WindowState::NotReady => (
            "the state is `not ready`",
            "switch the machine on, home it if the control requires it, make the control ready",
        ),
        WindowState::Held => ("the machine is held", "inspect the machine, then reset the hold at the control"),
        WindowState::Alarm => {
            let state = format!("alarm {}: {}", status.alarm_code, alarm_meaning(status.alarm_code));
            let remedy =
                "inspect the machine, clear the alarm at the control, home the machine if the control requires it";
            return Some(ControllerError::not_ready(state, remedy));
        }
    };
    Some(ControllerError::not_ready(state, remedy))
}

/// Checks that the probe is open before the first motion.
pub(super) fn require_open_probe(status: &WindowStatus) -> Result<(), ControllerError> {
    if status.is_probe_closed { Err(ControllerError::ProbeClosed) } else { Ok(()) }
}

/// Whether a repeated request may succeed: nothing shows that the connection or the device is faulty. Exception
/// codes 5 and 6: the device needs more time.
pub(super) fn is_transient(error: &ModbusError) -> bool {
    match error {
        ModbusError::ReadBackFailed { source, .. } => is_transient(source),
        ModbusError::Timeout { .. } | ModbusError::UnexpectedReply { .. } | ModbusError::LineNotCleared { .. } => true,
        ModbusError::ExceptionReply { code, .. } => matches!(code, 5 | 6),
        _ => false,
    }
}
