//! Reason why a program stopped before its end: from the log, then emergency stop and power, then messages.

use super::prepare::clear_offset_command;
use super::result_log::ProgramResult;
use super::rsh::RshClient;
use crate::controllers::ControllerError;
use machine::Axis;

/// Returns why the program of `step` stopped; the machine has `axes`.
pub(super) async fn stop_reason(
    rsh: &mut RshClient,
    step: u32,
    result: Option<&ProgramResult>,
    axes: &[Axis],
) -> ControllerError {
    match result {
        Some(ProgramResult::UnexpectedContact) => ControllerError::UnexpectedContact { step },
        Some(ProgramResult::ProbeClosedAtStart) => ControllerError::ProbeStillClosed { step },
        Some(ProgramResult::NoContact) => ControllerError::NoContact { step },
        Some(ProgramResult::ProbeFault(fault)) => ControllerError::ProbeFault { fault: *fault },
        Some(ProgramResult::ProgramOffsetSlotNotZero) => ControllerError::not_ready(
            "the work offset slot G59.3 was set during the run",
            format!("enter {}, then start again", clear_offset_command(axes)),
        ),
        Some(ProgramResult::Touch(_)) | None => match reported_reason(rsh, step).await {
            Ok(reason) | Err(reason) => reason,
        },
    }
}

/// Returns why a command was refused: emergency stop or machine off, otherwise `refusal`.
pub(super) async fn refusal_reason(rsh: &mut RshClient, refusal: ControllerError) -> ControllerError {
    match estop_or_off_error(rsh).await {
        Ok(Some(reason)) | Err(reason) => reason,
        Ok(None) => refusal,
    }
}

/// Returns the reason that the control reports; `Err` if the control does not answer.
async fn reported_reason(rsh: &mut RshClient, step: u32) -> Result<ControllerError, ControllerError> {
    if let Some(reason) = estop_or_off_error(rsh).await? {
        return Ok(reason);
    }
    Ok(interpret_messages(step, &rsh.read_messages().await?))
}

/// Converts LinuxCNC's messages to an error. After a probing move or an input, LinuxCNC's interpreter requires an empty
/// motion queue; if the motion task reports the empty queue too late, the interpreter stops the program (2.9).
fn interpret_messages(step: u32, messages: &[String]) -> ControllerError {
    let has = |words: &str| messages.iter().any(|text| text.contains(words));
    if has("Probe tripped") {
        return ControllerError::UnexpectedContact { step };
    }
    if messages.iter().any(|text| text.contains("xceed") && text.contains("limit")) {
        return ControllerError::OutOfTravel { step, message: messages.join("; ") };
    }
    if has("Queue is not empty after") {
        return ControllerError::RealTimeTaskLate { step, message: messages.join("; ") };
    }
    let meaning = if messages.is_empty() {
        "the program stopped without a message: an operator stopped it at the control, or LinuxCNC's motion did \
         not reply to its task in time (COMM_TIMEOUT): see the output of LinuxCNC"
    } else {
        "LinuxCNC stopped the program"
    };
    ControllerError::line_refused(&format!("the program of step {step}"), messages.join("; "), meaning)
}

/// Returns an error for an active emergency stop or a machine that is off. An emergency stop comes without
/// a message.
async fn estop_or_off_error(rsh: &mut RshClient) -> Result<Option<ControllerError>, ControllerError> {
    if rsh.get("estop").await? != "OFF" {
        return Ok(Some(ControllerError::EmergencyStop));
    }
    if rsh.get("machine").await? != "ON" {
        return Ok(Some(ControllerError::MachineSwitchedOff { message: rsh.read_messages().await?.join("; ") }));
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Texts of LinuxCNC 2.9, as linuxcncrsh passed them on.
    #[test]
    fn each_linuxcnc_message_gives_the_expected_error() {
        let of = |text: &str| interpret_messages(7, &[text.to_owned()]);
        for text in ["Queue is not empty after probing", "Queue is not empty after external input"] {
            let late = of(text);
            assert!(matches!(late, ControllerError::RealTimeTaskLate { step: 7, .. }), "{late:?}");
            assert!(late.to_string().contains(text), "{late}");
            assert!(late.remedy().contains("latency-test"), "{}", late.remedy());
        }
        let touched = of("Probe tripped during non-probe move");
        assert!(matches!(touched, ControllerError::UnexpectedContact { step: 7 }), "{touched:?}");
        let far = of("Exceeded POSITIVE soft limit (40.00000) on joint 0");
        assert!(matches!(far, ControllerError::OutOfTravel { step: 7, .. }), "{far:?}");
        assert!(matches!(of("Unknown word"), ControllerError::LineRefused { .. }));
        let silent = interpret_messages(7, &[]).to_string();
        assert!(silent.contains("COMM_TIMEOUT"), "{silent}");
    }
}
