//! Reads the tool centre as LinuxCNC computes it: switchable kinematics apply their values for the time of one program,
//! which moves nothing.

use serde::Deserialize;

use super::driver::LinuxCncDriver;
use super::result_log::parse_position;
use super::{prepare, state};
use crate::controllers::{ControllerError, arrival};
use machine::Axis;
use machine::record::tool_centre::ToolCentreReading;
use planning::gcode::rs274::check_kinematics_command;

/// Number of values of the log line `axes`.
const AXIS_VALUE_COUNT: usize = 6;

/// Commands that switch the kinematics, from `[controller] tool_centre`.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToolCentreCommands {
    /// Switches tool centre point control on, such as M428.
    on: KinematicsCommand,
    /// Switches it off (identity), such as M429.
    off: KinematicsCommand,
}

#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
struct KinematicsCommand(String);

impl TryFrom<String> for KinematicsCommand {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        check_kinematics_command(&text).map_err(|reason| format!("`{text}`: {reason}"))?;
        Ok(Self(text))
    }
}

/// How this machine reads its tool centre.
#[derive(Debug, Clone, PartialEq)]
pub struct ToolCentreSettings {
    pub commands: ToolCentreCommands,
    /// Length of the stated stylus, mm.
    pub stylus_length_mm: f64,
}

impl ToolCentreSettings {
    /// `M66` waits until the kinematics are switched, and reads the position of the axes again.
    fn program(&self, log: &str) -> String {
        let Self { commands: ToolCentreCommands { on, off }, stylus_length_mm } = self;
        format!(
            "%\n(trued reads the tool centre; nothing moves)\nM70\nG21 G90 G49\nG92.2\nG59.3\n(LOGOPEN,{log})\n\
             (LOG,axes #5420 #5421 #5422 #5423 #5424 #5425)\nG43.1 Z{stylus_length_mm:.6}\n{}\nM66 E0 L0\n\
             (LOG,tool_centre #5420 #5421 #5422 {})\n{}\nM66 E0 L0\nG49\n(LOG,END)\n(LOGCLOSE)\nM72\n%\n",
            on.0,
            prepare::OFFSET_SLOT_PARAMETERS,
            off.0,
        )
    }
}

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
