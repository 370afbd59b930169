//! Checks after a part of a block's program has ended: the position reached, the probe input, the position of the
//! touch.

use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::driver::{LinuxCncDriver, MAX_LINK_WRITE_TIME, is_touch};
use super::result_log::ProgramResult;
use super::{path_check, state};
use crate::controllers::ControllerError;
use machine::record::motion::Motion;
use machine::{Axis, Position};
use planning::gcode::TransmissionUnit;

/// Maximum time for an axis to settle at its target.
const MAX_SETTLING_TIME: Duration = Duration::from_millis(500);

impl LinuxCncDriver {
    /// Checks, after the program has ended, that the machine has reached the end of the path. If LinuxCNC's task is
    /// late, its interpreter reads on before a probing move has begun (2.9, issue 3650): then only the end position
    /// shows a contact in that move.
    pub(super) async fn check_final_position(
        &mut self,
        step: u32,
        part: &TransmissionUnit,
    ) -> Result<(), ControllerError> {
        let deadline = Instant::now() + MAX_SETTLING_TIME;
        loop {
            let position = state::read_position(&mut self.rsh, &self.settings.axes).await?;
            match path_check::check_end_position(&part.motions, &position) {
                Ok(()) => return Ok(()),
                // The position is that of the feedback: an axis may still be settling.
                Err(_) if Instant::now() < deadline => sleep(MAX_LINK_WRITE_TIME).await,
                Err(error) => {
                    self.require_open_probe(step).await?;
                    return Err(error);
                }
            }
        }
    }

    pub(super) async fn require_open_probe(&mut self, step: u32) -> Result<(), ControllerError> {
        match self.rsh.get("probe_value").await?.as_str() {
            "0" => Ok(()),
            _ => Err(ControllerError::ProbeStillClosed { step }),
        }
    }

    /// Returns the position at the trigger, if `part` has a touch, with the orientation of the spindle, which is
    /// stored. The contact must be on the path of the probing move.
    pub(super) fn touch_position(
        &mut self,
        step: u32,
        part: &TransmissionUnit,
        result: Option<ProgramResult>,
    ) -> Result<Option<Position>, ControllerError> {
        let orientation = part.motions.iter().rev().find_map(|motion| match motion {
            Motion::OrientSpindle { s } => Some(*s),
            _ => None,
        });
        self.spindle_rad = orientation.or(self.spindle_rad);
        match (part.motions.iter().any(is_touch), result) {
            (true, Some(ProgramResult::Touch(at))) => {
                path_check::check_contact_on_path(&part.motions, &at)?;
                let at = at.filter_axes(|axis| self.settings.axes.contains(&axis));
                Ok(Some(self.spindle_rad.map_or(at.clone(), |s| at.with(Axis::S, s))))
            }
            (false, None) => Ok(None),
            _ => Err(ControllerError::UnreadableReply { text: format!("log of step {step}") }),
        }
    }
}
