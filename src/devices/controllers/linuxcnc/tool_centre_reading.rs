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

impl LinuxCncDriver {
    /// As [`ControllerDriver::read_tool_centre`](crate::controllers::ControllerDriver::read_tool_centre).
    pub(super) async fn run_tool_centre_program(
        &mut self,
        settings: &ToolCentreSettings,
    ) -> Result<ToolCentreReading, ControllerError> {
        let axes = self.settings.axes.clone();
        let before = state::read_position(&mut self.rsh, &axes).await?;
        let log = self.run_program_without_motion(&settings.program(&self.files.result_log_path())).await?;
        state::check_identity_kinematics(&mut self.rsh, &axes).await?;
        let after = state::read_position(&mut self.rsh, &axes).await?;
        arrival::check_position(&before, &after, |axis| arrival::axis_tolerance(axis, None))
            .map_err(arrival::moved_between_blocks_error)?;
        let ([x, y, z, slot @ ..], AXIS_VALUE_COUNT) = (&log.tool_centre_values[..], log.axis_values.len()) else {
            return Err(ControllerError::UnreadableReply { text: "the log of the tool centre".to_owned() });
        };
        prepare::check_offset_slot(slot, &axes)?;
        let position = parse_position(&log.axis_values).filter_axes(|axis| axes.contains(&axis));
        let position = self.spindle_rad.map_or(position.clone(), |s| position.with(Axis::S, s));
        Ok(ToolCentreReading { position, tool_centre_mm: [*x, *y, *z] })
    }
}
