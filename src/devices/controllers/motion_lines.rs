//! Lines of a proven block, motion by motion.

use std::time::Duration;

use crate::controllers::ControllerError;
use machine::record::motion::Motion;
use planning::gcode::TransmissionForm;
use planning::proof::ProvenBlock;

/// Maximum time that the spindle needs to reach its orientation.
pub(in crate::controllers) const MAX_ORIENT_TIME: Duration = Duration::from_secs(30);

/// One motion and the lines that command it.
pub(in crate::controllers) struct MotionLines<'a> {
    /// Step number of the block, for errors.
    pub step: u32,
    pub motion: &'a Motion,
    /// One or more lines.
    pub text: &'a str,
    /// Maximum time for which the machine is at rest in these lines: dwell, orientation of the spindle, waits for
    /// clamps.
    pub planned_standstill_time: Duration,
}

/// Returns the lines of the block, one entry per motion, in order.
///
/// # Errors
/// The block differs from the proven one, or was proven for another transmission.
pub(in crate::controllers) fn motion_lines(block: &ProvenBlock) -> Result<Vec<MotionLines<'_>>, ControllerError> {
    let step = block.step();
    if !matches!(block.transmission(), TransmissionForm::Lines { .. }) {
        return Err(ControllerError::WrongTransmission { step });
    }
    let lines = block.units()?.iter().map(|proven| match proven.unit.motions.as_slice() {
        [motion] => Ok(MotionLines {
            step,
            motion,
            text: &proven.unit.text,
            planned_standstill_time: planned_standstill_time(motion) + duration_or_zero(proven.unit.clamp_wait_s),
        }),
        _ => Err(ControllerError::WrongTransmission { step }),
    });
    lines.collect()
}

/// Maximum time at rest that the motion itself needs, without waits for clamps.
fn planned_standstill_time(motion: &Motion) -> Duration {
    match motion {
        Motion::Dwell { seconds } => duration_or_zero(*seconds),
        Motion::OrientSpindle { .. } => MAX_ORIENT_TIME,
        _ => Duration::ZERO,
    }
}

/// Zero if `seconds` is negative, not finite or too large.
pub(in crate::controllers) fn duration_or_zero(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or_default()
}
