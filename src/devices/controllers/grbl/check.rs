//! Checks that the reported modes, offsets and probe inputs permit motion. Grbl's lines carry no checksum: a
//! command may have been altered on the link.

use super::message::{GrblMessage, GrblStatus};
use crate::controllers::ControllerError;
use planning::proof::ProvenModeText;

/// Modal groups; one word of each group is in force.
const MODAL_GROUPS: [&[&str]; 5] = [
    &["G17", "G18", "G19"],
    &["G20", "G21"],
    &["G90", "G91"],
    &["G93", "G94", "G95"],
    &["G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3"],
];

/// Checks that the probe is open before the first motion.
pub(super) fn require_open_probe(status: &GrblStatus) -> Result<(), ControllerError> {
    if status.is_probe_closed { Err(ControllerError::ProbeClosed) } else { Ok(()) }
}

/// Checks the probe's health inputs that the machine file declares, by their letters.
pub(super) fn check_probe_health(status: &GrblStatus, modes: &ProvenModeText) -> Result<(), ControllerError> {
    let mut inputs = modes.probe_health_inputs();
    match inputs.find(|(input, _)| status.active_inputs.contains(input)) {
        Some((_, fault)) => Err(ControllerError::ProbeFault { fault }),
        None => Ok(()),
    }
}

/// Checks that the words of `head` in `MODAL_GROUPS` are in force (`$G`) and that the offsets of the active
/// coordinate system and of G92 are zero (`$#`).
pub(super) fn check_modes_and_offsets(
    head: &[String],
    modes: &[GrblMessage],
    offsets: &[GrblMessage],
) -> Result<(), ControllerError> {
    let active_words = modes.iter().find_map(|message| match message {
        GrblMessage::ModalWords(words) => Some(words),
        _ => None,
    });
    let mismatch = |detail: String| {
        let remedy = "start again; if the error occurs again, check the dialect and the cable";
        ControllerError::not_ready(format!("the modal state is not as set: {detail}"), remedy)
    };
    let active_words = active_words.ok_or_else(|| mismatch("the control does not report its modes ($G)".to_owned()))?;
    let mut coordinate_system = "G54";
    for group in MODAL_GROUPS {
        let code = head.iter().filter(|line| !line.starts_with('('));
        let mut words = code.flat_map(|line| line.split_whitespace());
        let Some(expected) = words.rfind(|word| group.contains(word)) else { continue };
        if !active_words.iter().any(|word| word == expected) {
            return Err(mismatch(format!("{expected} is not active")));
        }
        coordinate_system = expected;
    }
    for name in [coordinate_system, "G92"] {
        let zero = offsets.iter().any(|message| {
            matches!(message, GrblMessage::Offset { name: offset_name, values }
                if offset_name == name && values.iter().all(|value| *value == 0.0))
        });
        if !zero {
            return Err(mismatch(format!("the offset {name} is not zero")));
        }
    }
    Ok(())
}
