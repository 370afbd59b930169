//! Reason why a program stopped before its end: from the log first, then the switches, then the messages.

use super::not_ready::not_ready;
use super::prepare::clear_slot;
use super::result::Verdict;
use super::rsh::Rsh;
use crate::controllers::ControllerError;
use machine::Axis;

/// Returns why the program of `step` stopped; the machine has `axes`.
pub(super) async fn reason(
    rsh: &mut Rsh,
    step: u32,
    verdict: Option<&Verdict>,
    axes: &[Axis],
) -> ControllerError {
    match verdict {
        Some(Verdict::Contact) => ControllerError::UnexpectedContact { step },
        Some(Verdict::Tripped) => ControllerError::StillTripped { step },
        Some(Verdict::NoContact) => ControllerError::NoContact { step },
        Some(Verdict::Probe(fault)) => ControllerError::Probe { fault: *fault },
        Some(Verdict::Offset) => not_ready(
            "the work offset slot G59.3 was set during the run",
            &format!("enter {}, then start again", clear_slot(axes)),
        ),
        Some(Verdict::Touch(_)) | None => match told(rsh, step).await {
            Ok(reason) | Err(reason) => reason,
        },
    }
}

/// Returns why a command was refused: `refusal`, unless a switch explains it.
pub(super) async fn refused(rsh: &mut Rsh, refusal: ControllerError) -> ControllerError {
    match switches(rsh).await {
        Ok(Some(reason)) | Err(reason) => reason,
        Ok(None) => refusal,
    }
}

/// Returns the reason that the control reports; `Err` if the control does not answer.
async fn told(rsh: &mut Rsh, step: u32) -> Result<ControllerError, ControllerError> {
    if let Some(reason) = switches(rsh).await? {
        return Ok(reason);
    }
    Ok(meant(step, &rsh.messages().await?))
}

/// Converts LinuxCNC's messages to an error. Its interpreter checks its own queue after a probing move or
/// an input; if its motion is late and has not yet reported an empty queue, the interpreter stops the
/// program (2.9).
fn meant(step: u32, said: &[String]) -> ControllerError {
    let has = |words: &str| said.iter().any(|text| text.contains(words));
    if has("Probe tripped") {
        return ControllerError::UnexpectedContact { step };
    }
    if said.iter().any(|text| text.contains("xceed") && text.contains("limit")) {
        return ControllerError::OutOfTravel { step, said: said.join("; ") };
    }
    if has("Queue is not empty after") {
        return ControllerError::Late { step, said: said.join("; ") };
    }
    let meaning = if said.is_empty() {
        "it stopped without a message: an operator stopped it at the control, or LinuxCNC's motion did not \
         answer its task in time (COMM_TIMEOUT): see LinuxCNC's own output"
    } else {
        "it stopped the program"
    };
    ControllerError::Refused {
        line: format!("the program of step {step}"),
        reply: said.join("; "),
        meaning: meaning.to_owned(),
    }
}

/// Returns an error for an active emergency stop or a machine that is off. An emergency stop comes without
/// a message.
async fn switches(rsh: &mut Rsh) -> Result<Option<ControllerError>, ControllerError> {
    if rsh.get("estop").await? != "OFF" {
        return Ok(Some(ControllerError::EmergencyStop));
    }
    if rsh.get("machine").await? != "ON" {
        return Ok(Some(ControllerError::SwitchedOff { said: rsh.messages().await?.join("; ") }));
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Texts of LinuxCNC 2.9, as linuxcncrsh passed them on.
    #[test]
    fn each_message_has_its_own_meaning() {
        let of = |text: &str| meant(7, &[text.to_owned()]);
        for text in ["Queue is not empty after probing", "Queue is not empty after external input"]
        {
            let late = of(text);
            assert!(matches!(late, ControllerError::Late { step: 7, .. }), "{late:?}");
            assert!(late.to_string().contains(text), "{late}");
            assert!(late.remedy().contains("latency-test"), "{}", late.remedy());
        }
        let touched = of("Probe tripped during non-probe move");
        assert!(matches!(touched, ControllerError::UnexpectedContact { step: 7 }), "{touched:?}");
        let far = of("Exceeded POSITIVE soft limit (40.00000) on joint 0");
        assert!(matches!(far, ControllerError::OutOfTravel { step: 7, .. }), "{far:?}");
        assert!(matches!(of("Unknown word"), ControllerError::Refused { .. }));
        let silent = meant(7, &[]).to_string();
        assert!(silent.contains("COMM_TIMEOUT"), "{silent}");
    }
}
