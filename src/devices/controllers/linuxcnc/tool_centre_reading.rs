//! Runs the program that reads the tool centre, and checks its log.

use super::driver::LinuxCncDriver;
use super::result_log::parse_position;
use super::tool_centre::ToolCentreSettings;
use super::{prepare, state};
use crate::controllers::{ControllerError, arrival};
use machine::Axis;
use machine::record::tool_centre::ToolCentreReading;

/// Number of values of the log line `axes`.
const AXIS_VALUE_COUNT: usize = 6;
/// Value of #5220 while G59.3 is selected.
const SELECTED_G59_3: f64 = 9.0;

impl LinuxCncDriver {
    /// Reads the tool centre by a program that moves nothing and switches tool centre point control on and off again.
    /// An error if the switching, the position before and after, or the work offset G59.3 is not as expected.
    pub(super) async fn run_tool_centre_program(
        &mut self,
        settings: &ToolCentreSettings,
    ) -> Result<ToolCentreReading, ControllerError> {
        let axes = self.settings.axes.clone();
        let before = state::read_position(&mut self.rsh, &axes).await?;
        let log = self.run_program_without_motion(&settings.program(&self.files.result_log_path())).await?;
        // Positions show a wrong mode only while a rotary axis is away from zero.
        check_kinematics_modes(&log.kinematics_values)?;
        state::check_identity_kinematics(&mut self.rsh, &axes).await?;
        let after = state::read_position(&mut self.rsh, &axes).await?;
        arrival::check_position(&before, &after, |axis| arrival::axis_tolerance(axis, None))
            .map_err(arrival::moved_between_blocks_error)?;
        let ([x, y, z, selected_slot, slot @ ..], AXIS_VALUE_COUNT) =
            (&log.tool_centre_values[..], log.axis_values.len())
        else {
            return Err(ControllerError::UnreadableReply { text: "the log of the tool centre".to_owned() });
        };
        if *selected_slot != SELECTED_G59_3 {
            return Err(ControllerError::not_ready(
                "the command that switches tool centre point control on selects another work offset than G59.3",
                "state a command in `tool_centre` that switches the kinematics only",
            ));
        }
        prepare::check_offset_slot(slot, &axes)?;
        let position = parse_position(&log.axis_values).filter_axes(|axis| axes.contains(&axis));
        let position = self.spindle_rad.map_or(position.clone(), |s| position.with(Axis::S, s));
        Ok(ToolCentreReading { position, tool_centre_mm: [*x, *y, *z] })
    }
}

/// `modes`: `motion.switchkins-type` before the first command, after it, and after the second. The first and the last
/// must be equal, and the one between must differ.
fn check_kinematics_modes(modes: &[f64]) -> Result<(), ControllerError> {
    let [before, on, after] = modes else {
        return Err(ControllerError::UnreadableReply { text: format!("modes of the kinematics {modes:?}") });
    };
    if before == after && before != on {
        return Ok(());
    }
    Err(ControllerError::not_ready(
        format!(
            "the commands of `tool_centre` do not switch tool centre point control on and off: motion.switchkins-type was \
             {before}, then {on}, then {after}"
        ),
        "correct `tool_centre` in [controller]; it may be that `on` and `off` are exchanged",
    ))
}
