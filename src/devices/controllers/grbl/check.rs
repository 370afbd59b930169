//! Compares the control's reports with the commands that it was sent, and reads important values twice:
//! Grbl's lines carry no checksum.

use super::message::{Message, Status};
use crate::controllers::ControllerError;
pub(super) use crate::controllers::arrival::{astray, contact_off_path, tolerance};
use planning::proof::ProvenModes;

/// Modal groups; one word of each group is in force.
const GROUPS: [&[&str]; 5] = [
    &["G17", "G18", "G19"],
    &["G20", "G21"],
    &["G90", "G91"],
    &["G93", "G94", "G95"],
    &["G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3"],
];

/// Checks that the probe is open before the first motion.
pub(super) fn probe_open(status: &Status) -> Result<(), ControllerError> {
    if status.probe_closed { Err(ControllerError::ProbeClosed) } else { Ok(()) }
}

/// Checks the probe's health inputs that the machine file declares, by their letters.
pub(super) fn probe_health(status: &Status, modes: &ProvenModes) -> Result<(), ControllerError> {
    let mut inputs = modes.health_inputs();
    match inputs.find(|(input, _)| status.pins.contains(input)) {
        Some((_, fault)) => Err(ControllerError::Probe { fault }),
        None => Ok(()),
    }
}

/// Checks that the modal words of `head` are in force (`$G`) and that the active offsets are zero (`$#`).
pub(super) fn modes(
    head: &[String],
    modes: &[Message],
    offsets: &[Message],
) -> Result<(), ControllerError> {
    let in_force = modes.iter().find_map(|message| match message {
        Message::Modes(words) => Some(words),
        _ => None,
    });
    let unlike = |what: String| ControllerError::NotReady {
        state: format!("its modes are not as set: {what}"),
        remedy: "start again; if it comes again, check the dialect and the cable".to_owned(),
    };
    let in_force = in_force.ok_or_else(|| unlike("it does not tell them".to_owned()))?;
    let mut slot = "G54";
    for group in GROUPS {
        let code = head.iter().filter(|line| !line.starts_with('('));
        let mut said = code.flat_map(|line| line.split_whitespace());
        let Some(wanted) = said.rfind(|word| group.contains(word)) else { continue };
        if !in_force.iter().any(|word| word == wanted) {
            return Err(unlike(format!("{wanted} is not in force")));
        }
        slot = wanted;
    }
    for name in [slot, "G92"] {
        let zero = offsets.iter().any(|message| {
            matches!(message, Message::Offset { name: said, values }
                if said == name && values.iter().all(|value| *value == 0.0))
        });
        if !zero {
            return Err(unlike(format!("the offset {name} is not zero")));
        }
    }
    Ok(())
}
