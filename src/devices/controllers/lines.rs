//! Lines of a proven block, motion by motion.

use std::time::Duration;

use crate::controllers::ControllerError;
use machine::record::motion::Motion;
use planning::gcode::Transmission;
use planning::proof::ProvenBlock;

/// One motion and the lines that command it.
pub(in crate::controllers) struct Lines<'a> {
    pub step: u32,
    pub motion: &'a Motion,
    pub text: &'a str,
    /// Total time for which the control waits for the clamps in these lines.
    pub clamps_rest: Duration,
}

/// # Errors
/// The block differs from the proven one, or was proven for another transmission.
pub(in crate::controllers) fn of(block: &ProvenBlock) -> Result<Vec<Lines<'_>>, ControllerError> {
    let step = block.step();
    if !matches!(block.transmission(), Transmission::Lines { .. }) {
        return Err(ControllerError::Transmission { step });
    }
    let lines = block.units()?.iter().map(|proven| match proven.unit.motions.as_slice() {
        [motion] => Ok(Lines {
            step,
            motion,
            text: &proven.unit.text,
            clamps_rest: Duration::try_from_secs_f64(proven.unit.clamps_rest_s).unwrap_or_default(),
        }),
        _ => Err(ControllerError::Transmission { step }),
    });
    lines.collect()
}
