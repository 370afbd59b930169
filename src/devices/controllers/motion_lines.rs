//! Lines of a proven block, motion by motion.

use std::time::Duration;

use crate::controllers::ControllerError;
use machine::record::motion::Motion;
use planning::gcode::Transmission;
use planning::proof::ProvenBlock;

/// One motion and the lines that command it.
pub(in crate::controllers) struct MotionLines<'a> {
    pub step: u32,
    pub motion: &'a Motion,
    pub text: &'a str,
    /// Total time for which the control waits for the clamps in these lines.
    pub clamp_wait: Duration,
}

/// # Errors
/// The block differs from the proven one, or was proven for another transmission.
pub(in crate::controllers) fn motion_lines(block: &ProvenBlock) -> Result<Vec<MotionLines<'_>>, ControllerError> {
    let step = block.step();
    if !matches!(block.transmission(), Transmission::Lines { .. }) {
        return Err(ControllerError::WrongTransmission { step });
    }
    let lines = block.units()?.iter().map(|proven| match proven.unit.motions.as_slice() {
        [motion] => Ok(MotionLines {
            step,
            motion,
            text: &proven.unit.text,
            clamp_wait: Duration::try_from_secs_f64(proven.unit.clamp_wait_s).unwrap_or_default(),
        }),
        _ => Err(ControllerError::WrongTransmission { step }),
    });
    lines.collect()
}
